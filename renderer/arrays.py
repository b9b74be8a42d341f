"""Scene to contiguous arrays in flat NamedTuples: the one gate for dtype, shape and default.

What a kernel may assume is written here. All floats are float64, all indices int32.
"""

import math
from collections.abc import Collection
from typing import NamedTuple

import numpy as np

from termwise.renderer import material, sky_light, triangles
from termwise.renderer.by_reference import by_reference
from termwise.renderer.lights import Emitters, emitters_of, samples_differ
from termwise.renderer.material import Materials
from termwise.renderer.sky_light import SkyMap
from termwise.renderer.triangles import Geometry
from termwise.renderer.vector import Vec3
from termwise.scenes.model import Camera, Scene


@by_reference()
class ShadowRule(NamedTuple):
    """The paper's: centres (L, 3) of the lights, and each one's object (L,) int32, -1 for a point."""

    centre: np.ndarray
    object: np.ndarray


@by_reference()
class SkyArrays(NamedTuple):
    """A constant colour, or a texture (H, W, 3) on a sphere; the texture is (0, 0, 3) without one."""

    color: Vec3
    texture: np.ndarray
    center: Vec3
    radius: float
    equal_area: bool


class CameraArrays(NamedTuple):
    """Direction through film position (x, y), in pixels: corner + x across + y down, not normalised.

    `rule` is an index into PIXEL_RULES.
    """

    position: Vec3
    corner: Vec3
    across: Vec3
    down: Vec3
    width: int
    height: int
    rule: int


PIXEL_RULES = ("corner", "centre", "jitter")


class Skips(NamedTuple):
    """The skips that are decided at a hit, see `renderer.plan.SKIPS`; False: the work is done in vain."""

    occlusion: bool
    diffuse: bool
    horizon: bool
    throughput: bool
    pixel: bool


@by_reference()
class SceneArrays(NamedTuple):
    """All that a kernel sees of a scene; `ambient_range` 0 means that ambient occlusion is off.

    `ambient` is L_a0; where the ambient light is a textured sky, of which `sky_map` says where it is bright, it is 1.
    `faint` is the throughput below which the roulette plays for a specular chain, 0 for never; `pick_by_light` whether
    light sampling chooses among the emitters by what they may send to a point; `light_samples` how many light samples
    stand beside one estimate by photons; `most_survival` the most that a roulette of light lets live;
    `irradiance_factor` multiplies direct light; `ignore_object`, `face_forward`
    and `watertight` are the settings `ignore`, `normals` and `intersection` of the scene.
    """

    geometry: Geometry
    materials: Materials
    emitters: Emitters
    shadow_rule: ShadowRule | None
    sky: SkyArrays
    camera: CameraArrays
    ambient: Vec3
    sky_map: SkyMap | None
    ambient_range: float
    max_bounces: int
    rings: int
    faint: float
    pick_by_light: bool
    light_samples: int
    most_survival: float
    irradiance_factor: float
    ignore_object: bool
    face_forward: bool
    watertight: bool
    draw_lights: bool
    skips: Skips


# A chain of less throughput goes on with probability throughput / FAINT, at the throughput FAINT: unbiased, and faster
# where most samples weigh next to nothing. Paths of direct light play by it too.
FAINT = 0.1
# Below 1, so that a path in a closed box of albedo 1 ends; 1 / P keeps the mean.
MAX_SURVIVAL, ENDLESS = 0.99, 0.9999
# Emitters among which light sampling chooses by what they may send to the point. Two are the halves of a rectangle; the
# choice looks at each, which costs too much among many.
FEW_EMITTERS, MANY_EMITTERS = 2, 512
# An estimate by photons costs what some 40 light samples do, and one light sample is the noisier of the two.
LIGHT_SAMPLES = 4


def light_samples(scene: Scene, without: Collection[str] = ()) -> int:
    """How many light samples stand beside one estimate by photons: one where all samples of the light are alike."""
    single = "splitting" in without or scene.scope != "all" or not samples_differ(scene)
    return 1 if single else LIGHT_SAMPLES


def most_survival(scene: Scene) -> float:
    """MAX_SURVIVAL, or the largest albedo where that is more.

    Throughput, times a / P a vertex, then never grows; with P = 0.99 its variance in a closed box is infinite from
    a = 0.995 on.
    """
    brightest = max((max(scene.diffuse_weight(thing.surface)) for thing in scene.objects), default=0.0)
    return max(MAX_SURVIVAL, min(brightest, ENDLESS))


def from_scene(scene: Scene, *, without: Collection[str] = ()) -> SceneArrays:
    """Flatten a validated scene and build its tree; `without` names skips and reductions that are not taken."""
    emitters = emitters_of(scene)
    return SceneArrays(
        triangles.from_scene(scene),
        material.from_scene(scene, without),
        emitters,
        _shadow_rule(scene),
        _sky(scene, without),
        _camera(scene.camera, scene.resolution),
        Vec3(1.0, 1.0, 1.0) if scene.ambient_light is None else Vec3(*scene.ambient_light),
        sky_light.from_scene(scene),
        scene.occlusion_range,
        scene.max_bounces,
        scene.rings,
        0.0 if "roulette" in without else FAINT,
        "lights" not in without and FEW_EMITTERS < len(emitters.kind) <= MANY_EMITTERS,
        light_samples(scene, without),
        most_survival(scene),
        scene.irradiance_factor,
        scene.ignore == "object",
        scene.normals == "viewer",
        scene.intersection == "watertight",
        scene.draw_lights,
        Skips(*(name not in without for name in Skips._fields)),
    )


def _shadow_rule(scene: Scene) -> ShadowRule | None:
    """None of a scene that goes by visibility alone: its kernels are compiled without."""
    if scene.shadows != "paper":
        return None
    centres = scene.light_centres
    return ShadowRule(
        np.array([centre for centre, _ in centres]).reshape(-1, 3), np.array([thing for _, thing in centres], np.int32)
    )


def _sky(scene: Scene, without: Collection[str]) -> SkyArrays:
    sky = scene.sky
    color = sky.color
    texture = np.zeros((0, 0, 3)) if sky.texture is None else sky.texture.astype(np.float64)
    if sky.texture is not None and sky.is_black and "texture" not in without:
        color, texture = (0.0, 0.0, 0.0), np.zeros((0, 0, 3))
    equal_area = sky.projection == "equal-area"
    return SkyArrays(Vec3(*color), np.ascontiguousarray(texture), Vec3(*sky.center), sky.radius, equal_area)


def _camera(camera: Camera, resolution: tuple[int, int]) -> CameraArrays:
    width, height = resolution
    right, up, forward = camera.frame()
    extent = 2.0 * camera.near * math.tan(math.radians(camera.fov) / 2.0)
    across = extent * right
    down = -extent * height / width * up
    corner = camera.near * forward - 0.5 * across - 0.5 * down
    return CameraArrays(
        Vec3(*camera.position),
        Vec3(*corner.tolist()),
        Vec3(*(across / width).tolist()),
        Vec3(*(down / height).tolist()),
        width,
        height,
        PIXEL_RULES.index(camera.pixel),
    )
