"""`make engines`: an environment for each engine that ships and has `packages`; what cannot be had is named."""

import shutil
import subprocess
import sys

from termwise.reports.engines.engine import EngineError, load, shipped


def install() -> None:
    """Install those that are not installed, and say of each whether it is here."""
    for name in shipped():
        engine = load(name)
        folder = engine.says.environment
        if engine.says.packages and not engine.installed:
            print(f"{name}: installing {', '.join(engine.says.packages)} into {folder}", flush=True)
            shutil.rmtree(folder, ignore_errors=True)  # half of one
            try:
                subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
                pip = [str(engine.python), "-m", "pip", "install", "--disable-pip-version-check", "--no-compile", "-qq"]
                subprocess.run([*pip, *engine.says.packages], check=True)
                engine.stamp.touch()
            except (OSError, subprocess.CalledProcessError) as error:
                shutil.rmtree(folder, ignore_errors=True)
                print(f"{name}: skipped: {error}")
                continue
        try:
            print(f"{name}: version {engine.version}")
        except EngineError as error:
            print(f"{name}: skipped: {error}")


if __name__ == "__main__":
    install()
