"""The native libraries that Dr.Jit opens, got without root where Debian's packages can be had.

Dr.Jit links libatomic.so.1 (without it Mitsuba does not import) and opens the LLVM that
`DRJIT_LIBLLVM_PATH` names. A bare Debian has neither. Its packages are downloaded with apt's lists and
archives kept beside the installed Python packages, unpacked there, and opened by full path before Dr.Jit asks
for them by name: the loader then takes those.
This module imports neither mitsuba nor drjit.
"""

import contextlib
import ctypes
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

# Dr.Jit 1.5 refuses LLVM 14, and 15 and 16 end the process ("Cannot select: fminimum"); 19 was seen to work.
FETCHED_LLVM = 19

_SYSTEM_FOLDERS = (
    "usr/lib/*-linux-gnu*",
    "usr/lib/llvm-*/lib",
    "usr/lib",
    "usr/lib64",
    "usr/lib64/llvm*/lib*",
    "usr/local/lib",
    "usr/local/opt/llvm*/lib",
    "opt/homebrew/opt/llvm*/lib",
)


class FetchError(RuntimeError):
    """The packages could not be fetched; the message says why in one line."""


def fetched_folder() -> Path:
    """Where fetched packages are unpacked: in the Python environment, for they are installed once with it."""
    return Path(sys.prefix) / "native"


def llvm_version(library: Path) -> tuple[int, ...]:
    """Version in the file name of an LLVM library, links followed; empty when it carries none.

    `libLLVM-15.so.1` is 15 (the 1 counts binary interfaces), `libLLVM.so.19.1` is 19.1.
    """
    match = re.fullmatch(r"libLLVM-(\d[\d.]*?)\.(?:so|dylib).*|libLLVM\.so\.(\d[\d.]*)", library.resolve().name)
    return tuple(int(part) for part in (match[1] or match[2]).split(".")) if match else ()


def llvm_libraries() -> list[Path]:
    """LLVM libraries in the order to try: the user's, the fetched one, the system's from the newest down."""
    named = os.environ.get("DRJIT_LIBLLVM_PATH")
    found = [Path(named)] if named else []
    for root in (fetched_folder(), Path("/")):
        libraries = {
            library.resolve()
            for folder in _SYSTEM_FOLDERS
            for name in ("libLLVM[-.]*so*", "libLLVM*.dylib")
            for library in root.glob(f"{folder}/{name}")
        }
        found += sorted(libraries, key=llvm_version, reverse=True)
    return list(dict.fromkeys(found))


def loadable(library: str | Path) -> bool:
    """Open a shared library for the whole process, by full path or by a name; False where that fails."""
    try:
        ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL)
    except OSError:
        return False
    return True


def lacks_libatomic() -> bool:
    """Whether libatomic, which Dr.Jit links on Linux, is missing."""
    return sys.platform == "linux" and not loadable("libatomic.so.1")


def preload() -> None:
    """Open the fetched libraries, LLVM apart, so that libraries opened later find them.

    The system's own file wins where there is one: two copies of one library in a process are a fault.
    """
    waiting = [file for file in fetched_folder().rglob("lib*.so.*") if not file.name.startswith("libLLVM")]
    opened = True
    while waiting and opened:  # a library opens only after those that it links
        opened = [file for file in waiting if loadable(file.name) or loadable(file)]
        waiting = [file for file in waiting if file not in opened]


def fetch(*, llvm: bool) -> None:
    """Download libatomic1, and LLVM if asked for, with what they need and the system lacks, and unpack them.

    Raises
    ------
    FetchError : without apt-get and dpkg, without a network, or where the lists have no LLVM that is new enough.
    """
    if not (shutil.which("apt-get") and shutil.which("dpkg")):
        raise FetchError("packages are fetched with apt-get and dpkg only, which this system lacks")
    target = fetched_folder()
    with tempfile.TemporaryDirectory(dir=target.parent, prefix=".native-") as name:
        work = Path(name)
        for folder in ("lists/partial", "apt/archives/partial", "root"):
            (work / folder).mkdir(parents=True)
        options = {
            "Dir::State::lists": work / "lists",
            "Dir::Cache": work / "apt",
            "Debug::NoLocking": "true",
            "APT::Sandbox::User": "root",  # started by root, apt's own user may not enter the folder
            "Acquire::Languages": "none",
            "APT::Install-Recommends": "false",
        }
        apt = [f"-o{key}={value}" for key, value in options.items()]
        # A hook of the system's own may fail for an ordinary user after a good update: the next steps tell.
        with contextlib.suppress(FetchError):
            _run("apt-get", *apt, "update")
        packages = ["libatomic1"]
        if llvm:
            packages.append(_llvm_package(_run("apt-cache", *apt, "pkgnames", "libllvm")))
        _run("apt-get", *apt, "--yes", "--download-only", "install", *packages)
        for archive in (work / "apt/archives").glob("*.deb"):
            _run("dpkg", "--extract", str(archive), str(work / "root"))
        shutil.rmtree(target, ignore_errors=True)
        (work / "root").rename(target)


def _llvm_package(names: str) -> str:
    """Name of the package to fetch out of `apt-cache pkgnames`: the oldest release from FETCHED_LLVM up."""
    found = [match for name in names.split() if (match := re.fullmatch(r"libllvm(\d+)(t64)?", name))]
    fitting = [match for match in found if int(match[1]) >= FETCHED_LLVM]
    if not fitting:
        raise FetchError(f"the package lists could not be had, or offer no libllvm{FETCHED_LLVM} or newer")
    return min(fitting, key=lambda match: int(match[1]))[0]


def _run(*command: str) -> str:
    done = subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL)
    if done.returncode:
        lines = (done.stderr or done.stdout).strip().splitlines() or [f"exit status {done.returncode}"]
        raise FetchError(f"{command[0]} failed: {lines[-1]}")
    return done.stdout
