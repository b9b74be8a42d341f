"""Renders replicates in a tree of sources that is not this one: `python worker.py CASE IMAGES`, its root the path.

CASE is a case as JSON, with seeds, IMAGES the file for what comes out, (seeds, K, H, W, 3) float32. Nothing but
`renderer` and `scenes` is imported: a fault may be planted in any of their files, and in no other is an image made.
"""

import json
import math
import sys
from collections.abc import Callable
from pathlib import Path

import attrs
import numpy as np

from termwise import renderer
from termwise.renderer import Engine, find
from termwise.scenes.analytic import plate
from termwise.scenes.load import load
from termwise.scenes.model import Ambient, Material, Mesh, Object, PointLight, Scene, Sky
from termwise.scenes.textures import Texture

_KEPT_BYTES = 1 << 26


def _material(**fields: object) -> Callable[[Scene], Scene]:
    """Give all surfaces the same lobe."""

    def change(scene: Scene) -> Scene:
        things = (attrs.evolve(thing, material=attrs.evolve(thing.material, **fields)) for thing in scene.objects)
        return attrs.evolve(scene, objects=tuple(things))

    return change


def _first(change: Callable[[Object], Object]) -> Callable[[Scene], Scene]:
    return lambda scene: attrs.evolve(scene, objects=(change(scene.objects[0]), *scene.objects[1:]))


def _turned(thing: Object) -> Object:
    return attrs.evolve(thing, mesh=attrs.evolve(thing.mesh, faces=np.ascontiguousarray(thing.mesh.faces[:, ::-1])))


def _smooth(scene: Scene) -> Scene:
    """Vertex normals on what is no plane."""
    things = (
        thing
        if len(thing.mesh.faces) == 2
        else attrs.evolve(thing, mesh=Mesh.from_arrays(thing.mesh.vertices, thing.mesh.faces, smooth=True))
        for thing in scene.objects
    )
    return attrs.evolve(scene, objects=tuple(things))


def _lamps(scene: Scene) -> Scene:
    """A fifth light, and more, of unequal power: so many are chosen among by what they send."""
    places = ((2.5, -2.0, 3.0, 20.0), (-1.0, -3.0, 1.5, 8.0), (0.5, 2.5, 4.0, 40.0))
    return attrs.evolve(
        scene, lights=(*scene.lights, *(PointLight((x, y, z), (i, i, 0.8 * i)) for x, y, z, i in places))
    )


def _only(kind: str) -> Callable[[Scene], Scene]:
    """Leave no light but those of a kind."""

    def change(scene: Scene) -> Scene:
        dark = (attrs.evolve(thing, emission=(0.0, 0.0, 0.0)) for thing in scene.objects)
        lights = tuple(light for light in scene.lights if light.kind == kind)
        return attrs.evolve(scene, objects=tuple(dark), lights=lights)

    return change


def _wide(scene: Scene) -> Scene:
    """A sun of 60 degrees."""
    lights = (attrs.evolve(light, angle=60.0) if light.kind == "sun" else light for light in scene.lights)
    return attrs.evolve(scene, lights=tuple(lights))


def _textured(scene: Scene) -> Scene:
    """An image on each surface, a quarter of it black, along x and y with a slant: seen on all sides, over borders."""
    texels = np.random.default_rng(7).uniform(0.1, 0.9, (5, 4, 3)).astype(np.float32)
    texels[1:3, 1:3] = 0.0
    low, high = scene.bounds()
    slant = np.array([(1.0, 0.0), (0.0, 1.0), (0.6, 0.8)]) * 2.5 / (high - low).max()

    def laid(thing: Object) -> Object:
        mesh = attrs.evolve(thing.mesh, uv=np.float32(thing.mesh.vertices[thing.mesh.faces] @ slant).astype(float))
        return attrs.evolve(thing, mesh=mesh, material=attrs.evolve(thing.material, color=Texture(texels)))

    return attrs.evolve(scene, objects=tuple(map(laid, scene.objects)))


def _screened(scene: Scene) -> Scene:
    """All lamps under an image that is brighter along x and y, of which they show the lower left part."""
    texels = np.random.default_rng(9).uniform(0.0, 2.0, (6, 5, 3)).astype(np.float32)
    texels *= np.linspace(20.0, 1.0, 6)[:, None, None] * np.linspace(1.0, 3.0, 5)[None, :, None]

    def shown(thing: Object) -> Object:
        if not thing.emits:
            return thing
        corners = thing.mesh.vertices[thing.mesh.faces]
        low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
        places = (corners - low)[..., :2] / (high - low)[:2] * (0.9, 0.4)
        mesh = attrs.evolve(thing.mesh, uv=np.float32(places).astype(float))
        return attrs.evolve(thing, mesh=mesh, emission=Texture(texels))

    return attrs.evolve(scene, objects=tuple(map(shown, scene.objects)))


def _grained(scene: Scene) -> Scene:
    """Gloss and roughness as images, on what has an image already."""
    values = np.random.default_rng(8).uniform(0.0, 0.6, (2, 3, 4))
    return _material(gloss=Texture(values[0]), roughness=Texture(0.2 + values[1]), f0=(0.9, 0.6, 0.4))(scene)


def _frosted(scene: Scene) -> Scene:
    """Nothing that is transparent is smooth."""
    rough = (
        attrs.evolve(thing, material=attrs.evolve(thing.material, roughness=0.5))
        if thing.material.transparency
        else thing
        for thing in scene.objects
    )
    return attrs.evolve(scene, objects=tuple(rough))


def _thin(scene: Scene) -> Scene:
    """Nothing that is transparent casts a shadow, and all of it is tinted."""

    def thin(thing: Object) -> Object:
        if not thing.material.transparency:
            return thing
        return attrs.evolve(thing, material=attrs.evolve(thing.material, occludes=False, tint=(0.7, 0.5, 0.9)))

    return attrs.evolve(scene, objects=tuple(map(thin, scene.objects)))


def _behind(scene: Scene) -> Scene:
    """Seen from the other side."""
    x, y, z = scene.camera.position
    return attrs.evolve(scene, camera=attrs.evolve(scene.camera, position=(x, -y, z)))


def _pool(scene: Scene) -> Scene:
    """Waves over all that stands on the ground, which hide the lamp; a lamp below them, and ambient light."""
    black, white = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)
    water = Material(black, 1.0, 0.3, transparency=1.0, ior=1.33, tint=(0.7, 0.9, 1.0))
    waves = plate("water", (-20.0, -20.1, 1.7), (40.0, 0.0, 0.0), (0.0, 40.2, 0.0), water)
    lamp = PointLight((0.0, -2.5, 1.4), (3.0, 3.0, 3.0))
    return attrs.evolve(
        scene, objects=(*scene.objects, waves), lights=(lamp,), ambient=Ambient(white, range=0.5), max_bounces=4
    )


_CHANGES: dict[str, Callable[[Scene], Scene]] = {
    "glossy": _material(gloss=0.5, roughness=0.6, f0=(0.04, 0.04, 0.04)),
    "metal": _material(gloss=0.7, roughness=0.5, f0=(0.9, 0.9, 0.9)),
    "faint": _material(gloss=0.1, roughness=0.5, f0=(0.9, 0.6, 0.4)),
    "turned": _first(_turned),
    "smooth": _smooth,
    "lamps": _lamps,
    "spot": _only("spot"),
    "directional": _only("directional"),
    "sun": _only("sun"),
    "sphere": _only("sphere"),
    "wide": _wide,
    "plain": lambda scene: attrs.evolve(scene, sky=Sky((0.5, 0.6, 0.8))),
    "panorama": lambda scene: attrs.evolve(scene, sky=attrs.evolve(scene.sky, projection="lat-long", radius=math.inf)),
    "shadowed": lambda scene: attrs.evolve(scene, shadows="paper"),
    "skylit": lambda scene: attrs.evolve(scene, ambient=Ambient(source="sky")),
    "bright": lambda scene: attrs.evolve(scene, irradiance="E"),
    "textured": _textured,
    "grained": _grained,
    "screened": _screened,
    "drawn": lambda scene: attrs.evolve(scene, draw_lights=True),
    "deep": lambda scene: attrs.evolve(scene, max_bounces=8),
    "frosted": _frosted,
    "thin": _thin,
    "pool": _pool,
    "behind": _behind,
    "sharp": lambda scene: attrs.evolve(scene, photons=attrs.evolve(scene.photons, kernel="epanechnikov")),
}


@attrs.frozen
class Case:
    """What is rendered to show a fault.

    Attributes
    ----------
    scene : a library scene, before its name words of what is changed: `glossy`, `metal` and `faint` are lobes of all
        surfaces, `turned`: the first object's faces look the other way, `smooth`: vertex normals, `lamps`: more
        lights, `spot`, `directional`, `sun`, `sphere`: of all lights those alone, `wide`: a wide sun, `plain` and
        `panorama`: another sky, `skylit`: the sky is the ambient light, `shadowed` and `bright`: choices of the paper,
        `drawn`: lights are seen, `deep`: longer chains, `frosted`: all glass is rough, `thin`: it casts no shadow,
        `pool`: water over all that is seen, `behind`: the camera on the other side, `sharp`: another kernel of photons,
        `textured`: an image on all surfaces, `grained`: and their gloss and roughness too, `screened`: an image on all
        lamps.
    term, variant, samples : the estimator, and its samples a pixel in each replicate.
    side : pixels of an edge of the image.
    height : of the image; `side` without.
    after : a variant of the term that the same engine renders first, with room for what both may share.
    """

    scene: str
    term: str
    variant: str
    samples: int
    side: int = 32
    height: int | None = None
    after: str = ""

    def build(self) -> Scene:
        """The scene at the case's resolution."""
        *changes, name = self.scene.split()
        scene = load(name)
        scene = attrs.evolve(
            scene,
            resolution=(self.side, self.height or self.side),
            max_bounces=2,
            photons=attrs.evolve(scene.photons, count=8000, radius=0.6),
        )
        for change in changes:
            scene = _CHANGES[change](scene)
        return scene

    def __str__(self) -> str:
        """As tables name it."""
        size = f"{self.side} × {self.height}" if self.height else f"{self.side}"
        how = [f"{size} px", *([f"after {self.after}"] if self.after else [])]
        return f"{self.term} {self.variant}, {self.scene}, {', '.join(how)}"


def replicates(case: Case, count: int, seed: int) -> np.ndarray:
    """(count, H, W, 3) float32."""
    images = []
    kept = _KEPT_BYTES if case.after else 0
    with Engine(case.build(), threads=1, kept_bytes=kept) as engine:
        for k in range(count):
            for variant in (case.after, case.variant) if case.after else (case.variant,):
                *_, (_, image, _) = engine.prefixes(
                    find(case.term, variant), samples=case.samples, seed=seed, replicate=k
                )
            images.append(image)
    return np.array(images, np.float32)


if __name__ == "__main__":
    # The environment also knows an installed renderer, in which no fault is planted.
    if not Path(renderer.__file__).is_relative_to(Path.cwd()):
        sys.exit(f"{renderer.__file__}: not of the tree {Path.cwd()}")
    settings = json.loads(sys.argv[1])
    case = Case(**settings["case"])
    np.save(sys.argv[2], [replicates(case, settings["count"], seed) for seed in settings["seeds"]])
