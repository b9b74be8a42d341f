"""What an engine is asked: a scene in the neutral words, and how often its light may scatter.

A term is a scene of its own, so that an engine needs no outputs of terms. With `I(scene, depth)` the engine's image:

    total            I(scene)                                       all light, lamps and sky where the camera sees them
    ambient          I(sky = L_a0, diffuse parts alone, depth 1) - I(the same, black surfaces)
    direct           I(lights, diffuse parts alone, depth 1, or all) - I(the same, black surfaces)

What is subtracted is what the camera sees shine.
"""

import functools
import hashlib
import json
import math
from collections.abc import Callable, Sequence
from typing import Any

import attrs

from termwise.reports.engines.engine import Engine, Feature, Format
from termwise.scenes import limits
from termwise.scenes.exchange import neutral
from termwise.scenes.limits import Limit
from termwise.scenes.model import (
    BLACK,
    BLACK_SURFACE,
    Ambient,
    DirectionalLight,
    Material,
    Object,
    PointLight,
    Scene,
    Scope,
    Sky,
    SphereLight,
    SpotLight,
)
from termwise.scenes.terms import TABLE

TOTAL = "total"
ROWS = (TOTAL, "ambient", "direct", "direct all")
"""What is judged of an engine on a scene."""
_UNREAD = ("name", "conventions", "left_out")


@attrs.frozen(eq=False)
class Asked:
    """A scene as an engine is given it.

    Attributes
    ----------
    name : as messages call it.
    scene : in our model.
    described : as `scenes.exchange.neutral` has it; a furnace may say more than our model can.
    depth : how often light may scatter at surfaces: 0 is what the camera sees shine, 1 direct light; None: any number.
    noisy : whether images of other seeds must be others.
    enough : how often light scatters in it at most, whatever the depth, as about a convex body; None: any number.
    """

    name: str
    scene: Scene
    described: dict[str, Any]
    depth: int | None = None
    noisy: bool = True
    enough: int | None = None

    @classmethod
    def of(
        cls, name: str, scene: Scene, depth: int | None = None, *, noisy: bool = True, enough: int | None = None
    ) -> "Asked":
        """A scene of our model."""
        return cls(name, scene, neutral.describe(scene), depth, noisy, enough)

    @property
    def resolution(self) -> tuple[int, int]:
        """Width and height."""
        width, height = self.described["film"]["resolution"]
        return width, height

    @functools.cached_property
    def digest(self) -> str:
        """sha256 of all that decides the image; names do not."""
        told = {name: value for name, value in self.described.items() if name not in _UNREAD}
        told["objects"] = [{**thing, "name": ""} for thing in told["objects"]]
        state = hashlib.sha256(json.dumps((told, self.depth)).encode())
        state.update(self.scene.digest().encode())  # what the model says beside it, and the sky's image
        return state.hexdigest()


def _lit_by(described: dict[str, Any], kind: str) -> bool:
    return any(light["type"] == kind for light in described["lights"])


def _reflects_diffusely(material: dict[str, Any]) -> bool:
    return any(material["color"]) and material["gloss"] < 1.0 and material.get("transparency", 0.0) < 1.0


FEATURES: dict[str, Callable[[dict[str, Any]], bool]] = {
    "diffuse": lambda d: any(_reflects_diffusely(o["material"]) for o in d["objects"]),
    "glossy": lambda d: any(o["material"]["gloss"] > 0 for o in d["objects"]),
    "translucent": lambda d: any("translucency" in o["material"] for o in d["objects"]),
    "dielectric": lambda d: any("fresnel" in o["material"] for o in d["objects"]),
    "smooth": lambda d: any(o["normals"] is not None for o in d["objects"]),
    "area": lambda d: any(any(o["emission"]) for o in d["objects"]),
    "reflecting-lamp": lambda d: any(
        any(o["emission"]) and (any(o["material"]["color"]) or o["material"]["gloss"] > 0) for o in d["objects"]
    ),
    "point": lambda d: _lit_by(d, "point"),
    "spot": lambda d: _lit_by(d, "spot"),
    "directional": lambda d: _lit_by(d, "directional"),
    "sun": lambda d: _lit_by(d, "sun"),
    "sphere": lambda d: _lit_by(d, "sphere"),
    "constant-sky": lambda d: d["sky"] is not None and d["sky"]["type"] == "constant",
    "image-sky": lambda d: d["sky"] is not None and d["sky"]["type"] == "image",
}
"""What a scene may need of an engine, and whether a description needs it."""


_UNSAID: dict[Format, tuple[Feature, ...]] = {
    "neutral": (),
    "mitsuba": ("glossy", "dielectric", "sun"),
    "gltf": ("glossy", "dielectric", "reflecting-lamp", "spot", "sun", "sphere", "constant-sky", "image-sky"),
    "pbrt": ("glossy", "dielectric", "reflecting-lamp", "spot", "sun"),
    "termwise": ("reflecting-lamp",),
}
"""What a format has no exact word for."""


def lacking(engine: Engine, asked: Asked) -> str | None:
    """What a scene needs that the engine has not, in a few words; None where it has all."""
    says = engine.says
    needed = [name for name, needs in FEATURES.items() if needs(asked.described)]
    if more := [name for name in needed if name not in says.supports]:
        return f"the scene needs {', '.join(more)}, which its file does not name in `supports`"
    if unsaid := [name for name in needed if name in _UNSAID[says.scene]]:
        return f"its format, {says.scene}, has no exact word for {', '.join(unsaid)}"
    scatters = asked.enough if asked.depth is None else asked.depth
    if says.max_depth is not None and (scatters is None or scatters > says.max_depth):
        often = "any number of times" if scatters is None else f"{scatters} times"
        return f"its light scatters {often}, and its file says max_depth = {says.max_depth}"
    if asked.depth not in (None, says.max_depth) and says.scene not in ("mitsuba", "termwise"):
        if not says.names("depth"):
            return "its command has no {depth}"
    return None


@attrs.frozen(eq=False)
class Row:
    """An image that is judged: `sum of sign * I(asked)`, and what it is judged against.

    Attributes
    ----------
    name : one of `ROWS`; `direct` is that of the first hit, `direct all` that of all bounces.
    parts : what the engine is asked, with signs.
    limits : what the references of which the sum is meant are; each with the scene that it is rendered of.
    absent : why there is nothing to judge, whatever the engine; None where there is.
    transported : the same by full light transport, which can be cut; empty where light scatters once.
    """

    name: str
    parts: tuple[tuple[int, Asked], ...]
    limits: tuple[tuple[Scene, Limit], ...]
    absent: str | None = None
    transported: tuple[tuple[Scene, Limit], ...] = ()

    def cut(self, depth: int) -> tuple[tuple[Scene, Limit], ...]:
        """As `limits`, where light scatters so often at most."""
        return tuple(
            (scene, attrs.evolve(limit, depth=depth) if limit.transport == "physical" else limit)
            for scene, limit in self.transported
        )


_UNSEEN = PointLight, SpotLight, DirectionalLight
"""Lights that no camera sees."""


def rows(scene: Scene) -> list[Row]:
    """What is judged of an engine on a scene: all light, and the terms that are light transport of a scene."""
    return [total(scene), _ambient(scene), _direct(scene, "first-hit"), _direct(scene, "all")]


def total(scene: Scene) -> Row:
    """All light, against `physical`; lamps shine where the camera sees them, as in other renderers."""
    lit = attrs.evolve(scene, draw_lights=True, ambient=Ambient())
    physical = [(scene, limits.physical(term)) for term in TABLE if term != "background"]
    whole = (*physical, (lit, limits.correct("background", scene.scope)))
    absent = _odd(scene)
    if absent is None and scene.sky.is_black and not scene.has_lights:
        absent = "the scene has no light"
    return Row(TOTAL, ((1, Asked.of(f"{scene.name}: {TOTAL}", lit)),), whole, absent, whole)


def _ambient(scene: Scene) -> Row:
    things = [attrs.evolve(each, material=each.surface, emission=BLACK) for each in scene.objects]
    light = scene.sky if scene.ambient.source == "sky" else Sky(scene.ambient.color)
    under = attrs.evolve(_diffuse(scene, things), lights=(), ambient=Ambient(), sky=light)
    absent = TABLE["ambient"].absent(scene) or _odd(scene)
    if absent is None and not math.isinf(scene.occlusion_range):
        absent = f"its range, {scene.occlusion_range:g}, is none of light: only an infinite one is"
    if absent is None and any(isinstance(light, SphereLight) for light in scene.lights):
        absent = "it has a sphere that shines, whose surface would be missing without its light"
    return _term(scene, "ambient", under, 1, limits.correct("ambient", scene.scope), absent, seen=True)


def _direct(scene: Scene, scope: Scope) -> Row:
    name = {"first-hit": "direct", "all": "direct all"}[scope]
    lit = attrs.evolve(_diffuse(scene, scene.objects), sky=Sky(), ambient=Ambient(), draw_lights=True)
    depth = 1 if scope == "first-hit" else None
    absent = TABLE["direct"].absent(scene) or _odd(scene)
    lamps = any(thing.emits for thing in scene.objects) or any(not isinstance(light, _UNSEEN) for light in scene.lights)
    row = _term(scene, name, lit, depth, limits.correct("direct", scope), absent, seen=lamps)
    return row if depth else attrs.evolve(row, transported=((lit, limits.physical("direct")),))


def _term(
    scene: Scene, name: str, lit: Scene, depth: int | None, limit: Limit, absent: str | None, *, seen: bool
) -> Row:
    """A term: its scene, less what is `seen` to shine in it."""
    title = f"{scene.name}: {name}"
    parts = [(1, Asked.of(title, lit, depth))]
    if seen:
        black = tuple(attrs.evolve(each, material=BLACK_SURFACE) for each in lit.objects)
        shines = Asked.of(f"{title}, what shines", attrs.evolve(lit, objects=black), depth, noisy=False)
        parts.append((-1, shines))
    return Row(name, tuple(parts), ((scene, limit),), absent)


def _diffuse(scene: Scene, things: Sequence[Object]) -> Scene:
    """The objects with their diffuse parts alone, at their weights."""

    def plain(material: Material) -> Material:
        return attrs.evolve(material, color=scene.diffuse_weight(material), gloss=0.0, transparency=0.0, fresnel="auto")

    return attrs.evolve(scene, objects=tuple(attrs.evolve(each, material=plain(each.material)) for each in things))


def _odd(scene: Scene) -> str | None:
    """What a scene chooses that other renderers have no word for, or are not asked for."""
    if any(thing.images for thing in scene.objects):
        return "it has images on its surfaces, which engines are not asked for"
    choices = (("irradiance", "E / pi"), ("ignore", "face"), ("normals", "viewer"), ("shadows", "physical"))
    for name, usual in choices:
        if (value := getattr(scene, name)) != usual:
            return f"it has {name} = {value!r}, which is no light transport"
    return None if scene.camera.pixel == "jitter" else f"it has camera.pixel = {scene.camera.pixel!r}, no box filter"
