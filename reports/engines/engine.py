"""An engine: a renderer that is a command, as a TOML file tells it.

    command  a list, never a line for a shell; `{scene}`, `{output}`, `{spp}`, `{seed}`, ... stand for what it is given
    version  what decides its images beside that: what it prints, and the bytes of each file that the two name

Nothing here runs but `version`; see `running`.
"""

import functools
import hashlib
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import attrs

from termwise.scenes import strict
from termwise.scenes.model import in_range, positive
from termwise.scenes.store import cache_folder
from termwise.scenes.strict import FileError

SHIPPED = Path(__file__).parent / "shipped"
Format = Literal["neutral", "mitsuba", "gltf", "pbrt", "termwise"]
Feature = Literal[
    "diffuse",
    "glossy",
    "translucent",
    "dielectric",
    "smooth",
    "area",
    "reflecting-lamp",
    "point",
    "spot",
    "directional",
    "sun",
    "sphere",
    "constant-sky",
    "image-sky",
]
"""What a scene may need; see `asked.FEATURES`."""
PLACES = ("python", "bin", "here", "scene", "output", "folder", "spp", "seed", "depth", "threads")
"""What a command may name in braces."""
_PLACE = re.compile(r"\{([a-z_]+)\}")
_VERSION_S = 120.0
_DEEPEST = 1000

_count = in_range(1, 2**31 - 1)


class EngineError(ValueError):
    """An engine that is not here, or did not do what it was asked; the message is one line that names it."""


def _command(engine: object, attribute: attrs.Attribute, value: tuple[str, ...]) -> None:
    if not value or not value[0]:
        raise ValueError("command = []: allowed is a list, the program first")
    _known(attribute, value, PLACES)
    if not any("{scene}" in word for word in value):
        raise ValueError("command: lacks {scene}: allowed is a command that is given the scene")


def _version(engine: object, attribute: attrs.Attribute, value: tuple[str, ...]) -> None:
    _known(attribute, value, PLACES[:3])


def _known(attribute: attrs.Attribute, words: tuple[str, ...], places: tuple[str, ...]) -> None:
    for word in words:
        for name in _PLACE.findall(word):
            if name not in places:
                raise ValueError(f"{attribute.name}: {{{name}}}: allowed are {', '.join(f'{{{p}}}' for p in places)}")


def _inside(engine: object, attribute: attrs.Attribute, value: str) -> None:
    _known(attribute, (value,), ("folder", "seed"))
    if not value.startswith("{folder}/") or ".." in Path(value).parts:
        raise ValueError(f"output = {value!r}: allowed is a name in {{folder}}, the empty folder of each run")


@attrs.frozen(kw_only=True)
class EngineFile:
    """A renderer, as its file tells it.

    Attributes
    ----------
    name : of its rows and messages; lower-case words joined by hyphens.
    command : the program and its arguments. A program with a slash in its name is looked for from the file's folder.
    version : a command whose first line of output is its version; without one its program's size and date stand for it.
    scene : what `{scene}` is: the neutral JSON file; Mitsuba's XML, with samples, seed and depth in it; GLB; pbrt;
        a scene file of ours. See `formats`.
    supports : what it can render; a scene that needs more is ABSENT, with what it needs.
    output : the file that it writes, in `{folder}`, where it runs.
    layer : the one to read where a file has several of colour.
    accept_exit : exit statuses that are no failure, so long as the image is whole; below 0 that of a signal.
    timeout_s : seconds after which a run, with all that it has started, is ended.
    spp : samples per pixel where none are asked for.
    max_depth : how often light scatters in it at most: 1 is a renderer of direct light; None: as often as it likes.
        A scene whose light scatters more often is ABSENT.
    depth : what `{depth}` is where light may scatter as often as it likes; 1000 if not said.
    seeds : "reproducible" where one seed gives one image; else "varying", as where threads race.
    noiseless : whether images have no noise, so that they may all be the same.
    packages : what `make engines` installs for it, for pip; `{python}` is then the interpreter of that environment, and
        `{bin}` the folder of its programs.
    files : others that decide its images, named from the file's folder.
    """

    name: str = attrs.field(validator=attrs.validators.matches_re(r"[a-z0-9]+([.-][a-z0-9]+)*"))
    command: tuple[str, ...] = attrs.field(validator=_command)
    version: tuple[str, ...] = attrs.field(default=(), validator=_version)
    scene: Format = "neutral"
    supports: tuple[Feature, ...]
    output: str = attrs.field(default="{folder}/image.exr", validator=_inside)
    layer: str | None = None
    accept_exit: tuple[int, ...] = (0,)
    timeout_s: float = attrs.field(default=600.0, validator=positive)
    spp: int = attrs.field(default=64, validator=_count)
    max_depth: int | None = attrs.field(default=None, validator=attrs.validators.optional(_count))
    depth: int | None = attrs.field(default=None, validator=attrs.validators.optional(_count))
    seeds: Literal["reproducible", "varying"] = "reproducible"
    noiseless: bool = False
    packages: tuple[str, ...] = ()
    files: tuple[str, ...] = ()

    def __attrs_post_init__(self) -> None:
        """Refuse a command whose images could not differ, and a depth that it is not given."""
        if self.depth is not None and not self.names("depth"):
            raise ValueError(
                f"depth = {self.depth!r}: is unused, for command lacks {{depth}}: allowed is max_depth, where light "
                "scatters so often at most"
            )
        if not self.noiseless and not self.names("seed") and self.scene != "mitsuba":  # there the file holds it
            raise ValueError("command: lacks {seed}: allowed is a command that is given it, or noiseless = true")

    def scatters(self, asked: int | None) -> int:
        """What `{depth}` is where so much is asked; None: any number."""
        if asked is not None:
            return asked
        return min(self.depth or _DEEPEST, self.max_depth or _DEEPEST)

    def names(self, place: str) -> bool:
        """Whether the command is given something."""
        return any(f"{{{place}}}" in word for word in self.command)

    @property
    def environment(self) -> Path:
        """The folder of its Python environment, where it has `packages`; shared by all that have the same."""
        digest = hashlib.sha256(repr(sorted(self.packages)).encode()).hexdigest()[:8]
        first = re.split(r"[^A-Za-z0-9_-]", self.packages[0])[0] if self.packages else "python"
        return cache_folder() / "engines" / "environments" / f"{first}-{digest}"


@attrs.frozen
class Engine:
    """A renderer that is a command.

    Attributes
    ----------
    says : what its file says.
    path : of the file.
    """

    says: EngineFile
    path: Path

    @property
    def name(self) -> str:
        """As rows and messages call it."""
        return self.says.name

    @property
    def python(self) -> Path:
        """The interpreter that `{python}` is."""
        return self.says.environment / "bin" / "python" if self.says.packages else Path(sys.executable)

    @property
    def stamp(self) -> Path:
        """A file that is there where its environment is whole."""
        return self.says.environment / ".installed"

    @property
    def installed(self) -> bool:
        """Whether its environment is."""
        return self.stamp.is_file()

    @property
    def version(self) -> str:
        """As it prints it.

        Raises
        ------
        EngineError : it is not here, or does not say its version.
        """
        return _version_of(self)

    @property
    def digest(self) -> str:
        """sha256 of all that decides its images beside what it is asked: file, version, and the files that they name.

        Raises
        ------
        EngineError : as `version`; a file that it names is not there.
        """
        return _digest(self, self.version)

    def filled(self, words: tuple[str, ...], places: Mapping[str, object]) -> list[str]:
        """A command with what it is given in place of the names in braces."""
        known = {"python": self.python, "bin": self.python.parent, "here": self.path.parent, **places}
        program, *others = (_PLACE.sub(lambda match: str(known[match[1]]), word) for word in words)
        if "/" in program and not os.path.isabs(program):
            program = str(self.path.parent / program)
        return [program, *others]

    def variables(self) -> dict[str, str]:
        """The variables of its processes: ours, but for those that would lead its Python to our packages."""
        leads_away = ("PYTHONPATH", "PYTHONHOME") if self.says.packages else ()
        return {name: value for name, value in os.environ.items() if name not in leads_away}


@functools.cache
def _digest(engine: Engine, version: str) -> str:
    state = hashlib.sha256(repr((engine.says, version)).encode())
    for path in _adapter(engine):
        state.update(f"{path.name}\0".encode() + path.read_bytes())
    return state.hexdigest()


def _adapter(engine: Engine) -> list[Path]:
    """The files that its command and `files` name, whatever `{python}` is."""
    here = engine.path.parent
    named = [here / word.replace("{here}", str(here)) for word in engine.says.command if "/" in word]
    listed = [here / name for name in engine.says.files]
    for path in listed:
        if not path.is_file():
            raise EngineError(f"{engine.path}: files: {path.name!r}: no such file in {here}")
    return sorted({*listed, *(path for path in named if path.is_file())})


@functools.cache
def _version_of(engine: Engine) -> str:
    """The first line that `version` prints; without it, its program's size and date."""
    says = engine.says
    if says.packages and not engine.installed:
        raise EngineError(f"{says.name}: is not installed: `make engines` puts it into {says.environment}")
    program = engine.filled(says.command, dict.fromkeys(PLACES[3:], ""))[0]
    found = shutil.which(program)
    if found is None:
        raise EngineError(f"{says.name}: command: {program!r}: no such program is here, or it cannot be executed")
    if not says.version:
        state = Path(found).stat()
        return f"{state.st_size} bytes of {state.st_mtime_ns // 10**9}"
    words = engine.filled(says.version, {})
    try:
        ran = subprocess.run(
            words,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            timeout=_VERSION_S,
            env=engine.variables(),
        )
    except subprocess.TimeoutExpired:
        raise EngineError(f"{says.name}: version: took longer than {_VERSION_S:g} s and was ended") from None
    except OSError as error:
        raise EngineError(f"{says.name}: version: {words[0]!r}: {error.strerror or error}") from None
    lines = [line.strip() for line in ran.stdout.splitlines() if line.strip()]
    if not lines or ran.returncode not in says.accept_exit:
        said = lines[-1] if lines else "it printed nothing"
        raise EngineError(f"{says.name}: version: exit status {ran.returncode}: {said}")
    return lines[0]


def shipped() -> tuple[str, ...]:
    """Names of the engines that ship with Termwise."""
    return tuple(sorted(path.stem for path in SHIPPED.glob("*.toml")))


def load(engine: str | Path | Engine) -> Engine:
    """An engine that ships with Termwise by name, or any by the path of its TOML file.

    Raises
    ------
    FileError : a missing or malformed file, an unknown key, a value that is not allowed.
    """
    if isinstance(engine, Engine):
        return engine
    path = SHIPPED / f"{engine}.toml" if str(engine) in shipped() else Path(engine)
    if path.suffix != ".toml":
        raise FileError(f"{engine}: no such engine: allowed are {', '.join(shipped())} or a path that ends in .toml")
    return Engine(strict.read(path, EngineFile, strict.converter()), path.resolve())
