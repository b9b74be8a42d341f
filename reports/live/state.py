"""What a page shows: a scene, the variant of each term, samples and seed; and how an input changes it.

A state is immutable. An input is named by its path, say ("objects", 2, "material", "gloss"); a value that the scene's
model refuses leaves the state as it was, and the model's own message says why.
"""

import math
import shlex
import time
from pathlib import Path
from typing import Any, get_args

import attrs
import numpy as np

from termwise.renderer.auto import chosen
from termwise.renderer.plan import check
from termwise.renderer.terms import AUTO, Chain, Variant, find, names
from termwise.reports.jobs import cells
from termwise.scenes.load import library, load
from termwise.scenes.model import Camera, Mesh, Object, Scene, in_range
from termwise.scenes.terms import TERMS, Term

CHAIN: Chain = "next-event"
"""What `termwise render` has at the vertices of a specular chain."""
LARGEST = 1024
"""Pixels of a side: a page answers at once, or not at all."""
Steps = tuple[str | int, ...]


@attrs.frozen(eq=False)
class State:
    """All inputs of a picture.

    Attributes
    ----------
    scene : with its resolution.
    variants : name of the estimator of each term, "auto" of direct for the one that fits the scene.
    samples : per pixel, where refinement ends.
    seed : equal seeds give equal bits.
    """

    scene: Scene
    variants: dict[Term, str] = attrs.field(factory=lambda: {term: names(term)[0] for term in TERMS})
    samples: int = attrs.field(default=256, validator=in_range(1, 2**20))
    seed: int = attrs.field(default=0, validator=in_range(0, 2**31 - 1))

    def __attrs_post_init__(self) -> None:
        """Refuse what no estimator would follow, and pictures too large to watch."""
        if max(self.scene.resolution) > LARGEST:
            raise ValueError(f"resolution = {self.scene.resolution}: allowed is up to {LARGEST} here")
        for term in TERMS:
            # What `auto` takes fits.
            if self.variants[term] != AUTO:
                check(self.scene, self.variant(term), chain=CHAIN)

    def variant(self, term: Term) -> Variant:
        """The estimator of a term."""
        return chosen(self.scene, term, self.variants[term])

    def content(self, term: Term) -> tuple[Any, ...]:
        """All that decides the bits of a term's samples; equal where they can be kept.

        Of `auto` all that either variant may read, so that no page waits for the choice.
        """
        name = self.variants[term]
        variant = find(term, None if name == AUTO else name)
        return term, name, self.seed, cells.content(self.scene, variant, chain=CHAIN)


def invalidated(before: State, after: State) -> tuple[Term, ...]:
    """Terms that a change makes render anew."""
    return tuple(term for term in TERMS if before.content(term) != after.content(term))


def get(state: State, path: Steps) -> Any:
    """Value of an input."""
    value: Any = state
    for step in path:
        if isinstance(value, Object) and step in _OF_MESH:
            value = _short(_OF_MESH[step][0](value.mesh))
        else:
            value = _item(value, step)
    return value


def _short(value: Any) -> Any:
    """A number, or a triple, in six digits: vertices are float32, and have no more."""
    return tuple(map(_short, value)) if isinstance(value, tuple) else float(f"{value:.6g}")


def _item(value: Any, step: Any) -> Any:
    return value[step] if isinstance(value, tuple | dict) else getattr(value, step)


def put(state: State, path: Steps, value: Any) -> State:
    """The state with one input changed.

    Raises
    ------
    ValueError : the value is of another type or out of range: the message names field, value and what is allowed.
    """
    current = get(state, path)
    if isinstance(current, bool):
        if not isinstance(value, bool):
            raise ValueError(f"{path[-1]} = {value!r}: allowed is true or false")
    elif isinstance(current, int | float | None) and not (value is None and _optional(state, path)):
        value = _number(path, value, whole=isinstance(current, int))
    try:
        return _put(state, path, value)
    except ValueError as error:
        if path[:2] == ("scene", "objects"):
            raise ValueError(f"{get(state, (*path[:3], 'name'))}: {error}") from None
        raise


def _optional(state: State, path: Steps) -> bool:
    """Whether an input may be None."""
    holder = get(state, path[:-1])
    return attrs.has(type(holder)) and type(None) in get_args(attrs.fields_dict(type(holder))[str(path[-1])].type)


def _number(path: Steps, value: Any, *, whole: bool) -> float | int:
    kind = "an integer" if whole else "a number"
    if isinstance(value, bool) or not isinstance(value, int | float) or (whole and value != math.floor(value)):
        raise ValueError(f"{path[-1]} = {value!r}: allowed is {kind}")
    return int(value) if whole else float(value)


def _put(thing: Any, path: Steps, value: Any) -> Any:
    step, rest = path[0], path[1:]
    if isinstance(thing, Object) and step in _OF_MESH:
        read, write = _OF_MESH[step]
        new = _put(read(thing.mesh), rest, value) if rest else value
        return attrs.evolve(thing, mesh=write(thing.mesh, new))
    if isinstance(thing, tuple):
        assert isinstance(step, int)
        new = _put(thing[step], rest, value) if rest else value
        return (*thing[:step], new, *thing[step + 1 :])
    if isinstance(thing, dict):
        return thing | {step: value}
    new = _put(getattr(thing, str(step)), rest, value) if rest else value
    return attrs.evolve(thing, **{str(step): new})


def _extent(mesh: Mesh) -> float:
    """Root of the surface's area: the side of a square light."""
    corners = mesh.vertices[mesh.faces]
    crossed = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float(np.sqrt(0.5 * np.linalg.norm(crossed, axis=1).sum()))


def _moved(mesh: Mesh, centre: Any) -> Mesh:
    if not np.isfinite(centre).all():
        raise ValueError(f"position = {centre!r}: allowed are finite numbers")
    shifted = mesh.vertices + np.subtract(centre, mesh.centroid())
    return Mesh.from_arrays(shifted, mesh.faces, smooth=mesh.normals is not None, uv=mesh.uv)


def _scaled(mesh: Mesh, extent: float) -> Mesh:
    if not 0.0 < extent < math.inf:
        raise ValueError(f"size = {extent!r}: allowed is a number in (0, inf)")
    centre = np.array(mesh.centroid())
    scaled = centre + (mesh.vertices - centre) * (extent / _extent(mesh))
    return Mesh.from_arrays(scaled, mesh.faces, smooth=mesh.normals is not None, uv=mesh.uv)


# What an object's mesh is moved and scaled by: the centre of its surface, and the root of its area.
_OF_MESH: dict[Any, tuple[Any, Any]] = {"position": (Mesh.centroid, _moved), "size": (_extent, _scaled)}


def orbit(camera: Camera, right: float, up: float) -> Camera:
    """Turn the camera about its target, by degrees; the pole is not crossed."""
    away = np.subtract(camera.position, camera.target)
    axis = np.array(camera.up) / np.linalg.norm(camera.up)
    sideways = camera.frame()[0]
    above = math.degrees(math.asin(np.clip(away @ axis / np.linalg.norm(away), -1.0, 1.0)))
    up = float(np.clip(above + up, -89.0, 89.0)) - above
    for about, angle in ((sideways, -up), (axis, -right)):
        cos, sin = math.cos(math.radians(angle)), math.sin(math.radians(angle))
        # Rodrigues' rotation.
        away = away * cos + np.cross(about, away) * sin + about * (about @ away) * (1.0 - cos)
    return attrs.evolve(camera, position=_vector(camera.target + away))


def pan(camera: Camera, right: float, up: float) -> Camera:
    """Shift camera and target, by shares of their distance."""
    distance = np.linalg.norm(np.subtract(camera.position, camera.target))
    sideways, upwards, _ = camera.frame()
    shift = distance * (right * sideways + up * upwards)
    return attrs.evolve(camera, position=_vector(camera.position + shift), target=_vector(camera.target + shift))


def zoom(camera: Camera, factor: float) -> Camera:
    """Multiply the distance from the target."""
    away = np.subtract(camera.position, camera.target)
    return attrs.evolve(camera, position=_vector(camera.target + factor * away))


def _vector(values: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (round(float(value), 6) for value in values)
    return x, y, z


class History:
    """States that were shown, for undo and redo; changes of one input within a second are one."""

    def __init__(self, state: State, *, depth: int = 200) -> None:
        self._past: list[State] = []
        self._future: list[State] = []
        self._depth = depth
        self._last: tuple[object, float] = (None, -math.inf)
        self.state = state

    @property
    def can_undo(self) -> bool:
        """Whether there is a state before this one."""
        return bool(self._past)

    @property
    def can_redo(self) -> bool:
        """Whether a state was left by undo."""
        return bool(self._future)

    def push(self, state: State, what: object, *, now: float | None = None) -> None:
        """Go on to a state; `what` names the input that changed."""
        now = time.monotonic() if now is None else now
        before, at = self._last
        if before != what or now - at > 1.0 or not self._past:
            self._past.append(self.state)
            del self._past[: -self._depth]
        self._future.clear()
        self._last = what, now
        self.state = state

    def undo(self) -> State:
        """Go back by one change, if there is one."""
        if self._past:
            self._future.append(self.state)
            self.state = self._past.pop()
        self._last = None, -math.inf
        return self.state

    def redo(self) -> State:
        """Take back the last undo, if there is one."""
        if self._future:
            self._past.append(self.state)
            self.state = self._future.pop()
        self._last = None, -math.inf
        return self.state


def command(state: State, scene: str | Path, samples: int) -> str:
    """The command line whose picture has the same bits; `scene` is a name of the library or a saved file."""
    words = ["termwise", "render", str(scene), "--samples", str(samples), "--seed", str(state.seed)]
    described = load(scene)
    if described.resolution != state.scene.resolution:
        words += ["--resolution", *map(str, state.scene.resolution)]
    others = [f"{term}={name}" for term, name in state.variants.items() if name != names(term)[0]]
    for other in others:
        words += ["--variant", other]
    return shlex.join(words)


def named(state: State) -> str | None:
    """Name of the library's scene that this is, resolution apart; None where it is none."""
    for name in library():
        scene = attrs.evolve(load(name), resolution=state.scene.resolution)
        if scene.digest(without=("name",)) == state.scene.digest(without=("name",)):
            return name
    return None
