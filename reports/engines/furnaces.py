"""Scenes whose radiance is known exactly, pixel by pixel: what an engine is held against before any reference.

| scene | radiance |
|---|---|
| closed box, every face of albedo rho and emission e | e / (1 - rho); e (1 + rho) where light scatters once |
| sphere (convex) of albedo rho under a sky L | rho L |
| such a sphere, hollow, through which the share s goes | rho ((1 - s) L + s B), B = rho s L / (1 - rho (1 - s)) |
| open box of albedo 1 under a sky L | L, on all surfaces and beside them |
| plate of albedo rho below a rectangle that radiates L | rho E / pi, `E = L/2 sum_k theta_k n.Gamma_k` (Lambert) |
| plate of albedo rho below a point of intensity I | rho I cos / (pi d²) |
| the same below a black plate, whose edge casts its shadow along the middle of the picture | that, or 0 |

B is the radiance of the inside. theta_k is the angle that the k-th edge of the lamp is seen under, Gamma_k the unit
normal of the plane through edge and point; the plate and the lamp, which is black, do not light each other. Pixels are
means over their area by a rule of Gauss and Legendre. Emission and albedo together are said in these neutral
descriptions alone: our model's lamps are black.
"""

from collections.abc import Callable
from typing import Any

import attrs
import numpy as np
import trimesh

from termwise.reports.engines.asked import Asked
from termwise.scenes import analytic
from termwise.scenes.model import BLACK_SURFACE, Camera, Color, Material, Mesh, Object, PointLight, Scene, Sky

RESOLUTION = (16, 12)
_NODES = 4
"""Of a pixel's mean along each axis."""
_MIXED: Color = (0.2, 0.5, 0.8)
_BRIGHT: Color = (0.95, 0.9, 0.85)
_WHITE: Color = (1.0, 1.0, 1.0)
_POINT = PointLight((0.3, 0.2, 1.2), (8.0, 4.0, 2.0))


@attrs.frozen(eq=False)
class Furnace:
    """A scene whose radiance is known.

    Attributes
    ----------
    asked : the scene.
    exact : (H, W, 3) float64, its radiance.
    formula : the same in words.
    at_depth : (depth, count) -> (1, H, W, 3), what of it is left where light scatters so often at most; None where it
        scatters once, or that is not known.
    """

    asked: Asked
    exact: np.ndarray
    formula: str
    at_depth: Callable[[int, int], np.ndarray] | None = None

    @property
    def name(self) -> str:
        """Of the scene."""
        return self.asked.name


def furnaces() -> list[Furnace]:
    """All of them, the simplest first."""
    return [
        _sphere(_MIXED),
        _sphere(_BRIGHT),
        _lantern(_BRIGHT, 0.4),
        _open_box(),
        _closed_box(_MIXED, (1.0, 0.5, 0.25)),
        _closed_box(_BRIGHT, (0.25, 0.5, 1.0)),
        _closed_box(_MIXED, (1.0, 0.5, 0.25), depth=1),
        _point_on_plate(),
        _half_in_shadow(),
        _lamp_over_plate(),
    ]


def _constant(value: Color) -> np.ndarray:
    width, height = RESOLUTION
    return np.broadcast_to(np.array(value), (height, width, 3))


def _words(color: Color) -> str:
    return "/".join(f"{value:g}" for value in color)


def _sphere(albedo: Color) -> Furnace:
    """So near that it fills the picture."""
    ball = trimesh.creation.icosphere(subdivisions=1)
    sky: Color = (1.0, 2.0, 0.5)
    scene = Scene(
        f"sphere of albedo {_words(albedo)} under a sky",
        Camera((1.1, -0.7, 0.4), (0.0, 0.0, 0.0), fov=40.0),
        (Object("sphere", Mesh.from_arrays(ball.vertices, ball.faces), Material(color=albedo)),),
        sky=Sky(sky),
        resolution=RESOLUTION,
    )
    exact = np.array(albedo) * sky
    words = "rho L, for a convex thing sees the sky alone"
    return Furnace(_asked(scene, enough=1), _constant(tuple(exact)), words)


def _lantern(albedo: Color, share: float) -> Furnace:
    """A sphere that light crosses, so near that it fills the picture."""
    plain = _sphere(albedo).asked.scene
    (ball,) = plain.objects
    scene = attrs.evolve(
        plain,
        name=f"hollow sphere of albedo {_words(albedo)} and translucency {share:g} under a sky",
        objects=(attrs.evolve(ball, material=Material(color=albedo, translucency=share)),),
    )
    rho, sky = np.array(albedo), np.array(scene.sky.color)
    inside = rho * share * sky / (1.0 - rho * (1.0 - share))
    exact = rho * ((1.0 - share) * sky + share * inside)
    words = "rho ((1 - s) L + s B), B = rho s L / (1 - rho (1 - s)) within"
    return Furnace(_asked(scene), _constant(tuple(exact.tolist())), words)


def _open_box() -> Furnace:
    walls = trimesh.creation.box(extents=(2.0, 2.0, 2.0))
    lid = walls.face_normals[:, 2] > 0.5
    scene = Scene(
        "open box of albedo 1 under a sky",
        Camera((0.6, -1.6, 2.6), (0.0, 0.1, -0.4), fov=60.0),
        (Object("box", Mesh.from_arrays(walls.vertices, walls.faces[~lid]), Material(color=_WHITE)),),
        sky=Sky((1.0, 2.0, 0.5)),
        resolution=RESOLUTION,
    )
    return Furnace(_asked(scene), _constant(scene.sky.color), "L, for nothing is lost")


def _closed_box(albedo: Color, emission: Color, *, depth: int | None = None) -> Furnace:
    rho, light = np.array(albedo), np.array(emission)
    once = "" if depth is None else ", light scatters once"
    dark = attrs.evolve(
        analytic.closed_box(),
        name=f"closed box of albedo {_words(albedo)} and emission {_words(emission)}{once}",
        lights=(),
        resolution=RESOLUTION,
    )
    (box,) = dark.objects
    asked = _asked(attrs.evolve(dark, objects=(attrs.evolve(box, material=Material(color=albedo)),)), depth)
    described = asked.described | {"objects": [asked.described["objects"][0] | {"emission": list(emission)}]}
    exact = light / (1.0 - rho) if depth is None else light * (1.0 + rho)
    formula = "e / (1 - rho)" if depth is None else "e (1 + rho)"

    def at_depth(depth: int, count: int) -> np.ndarray:
        return _constant(tuple(light * (1.0 - rho ** (depth + 1)) / (1.0 - rho)))[None]

    asked = attrs.evolve(asked, described=described)
    return Furnace(asked, _constant(tuple(exact)), formula, at_depth if depth is None else None)


def _plate(name: str, **lit: Any) -> Scene:
    """A plate that fills the picture, and room above it."""
    plate = analytic.plate("plate", (-4.0, -4.5, 0.0), (8.0, 0.0, 0.0), (0.0, 9.0, 0.0), Material(color=_MIXED))
    camera = Camera((0.0, -1.5, 0.8), (0.0, 0.0, 0.0), fov=50.0)
    scene = Scene(name, camera, (plate,), resolution=RESOLUTION)
    return attrs.evolve(scene, **lit)


def _point_on_plate() -> Furnace:
    scene = _plate("point light over a plate", lights=(_POINT,))
    return Furnace(_asked(scene, enough=1), _over_pixels(scene, _of_point), "rho I cos / (pi d²)")


def _of_point(points: np.ndarray) -> np.ndarray:
    """Irradiance (N, 3) at points on z = 0, facing up."""
    way = np.array(_POINT.position) - points
    return (way[:, 2] / np.linalg.norm(way, axis=1) ** 3)[:, None] * np.array(_POINT.intensity)


def _half_in_shadow() -> Furnace:
    """Above the picture, a black plate whose edge's shadow is the line x = 0: the border of two columns of pixels."""
    height = 0.9
    edge = _POINT.position[0] * height / _POINT.position[2]
    black = analytic.plate("blocker", (edge - 2.0, -2.0, height), (2.0, 0.0, 0.0), (0.0, 4.5, 0.0), BLACK_SURFACE)
    plain = _plate("plate half in the shadow of another", lights=(_POINT,))
    scene = attrs.evolve(plain, objects=(*plain.objects, black))

    def irradiance(points: np.ndarray) -> np.ndarray:
        return np.where(points[:, :1] > 0.0, _of_point(points), 0.0)

    return Furnace(_asked(scene, enough=1), _over_pixels(scene, irradiance), "rho I cos / (pi d²), and 0 in the shadow")


def _lamp_over_plate() -> Furnace:
    lamp = analytic.plate("lamp", (-1.3, -0.9, 1.4), (0.0, 2.2, 0.0), (2.6, 0.0, 0.0))  # its front looks down
    shining = Object("lamp", lamp.mesh, emission=(1.0, 2.0, 4.0))
    plain = _plate("rectangle light over a plate")
    scene = attrs.evolve(plain, objects=(*plain.objects, shining))
    corners = shining.mesh.vertices

    def irradiance(points: np.ndarray) -> np.ndarray:
        return form(points, corners)[:, None] * np.array(shining.emission)

    return Furnace(_asked(scene, enough=1), _over_pixels(scene, irradiance), "rho E / pi by Lambert's polygon formula")


def form(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """E / L (N,) at points on z = 0, facing up, of a polygon above them whose front looks down."""
    to = corners - points[:, None]
    to /= np.linalg.norm(to, axis=2, keepdims=True)
    after = np.roll(to, -1, axis=1)
    normal = np.cross(to, after)
    sine = np.linalg.norm(normal, axis=2)
    angle = np.arctan2(sine, np.sum(to * after, axis=2))
    return -np.sum(angle * normal[..., 2] / sine, axis=1) / 2.0


def _over_pixels(scene: Scene, irradiance: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Radiance of the plate (H, W, 3): means over pixels of rho E / pi."""
    width, height = scene.resolution
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    inside = (nodes + 1.0) / 2.0
    y, x, v, u = np.meshgrid(np.arange(height), np.arange(width), inside, inside, indexing="ij")
    film = np.stack([(x + u) / width, (y + v) / height], axis=-1).reshape(-1, 2)
    ways = scene.camera.rays(film, aspect=scene.aspect)
    origin = np.array(scene.camera.position)
    points = origin - (origin[2] / ways[:, 2])[:, None] * ways
    values = (np.array(_MIXED) / np.pi * irradiance(points)).reshape(height, width, _NODES, _NODES, 3)
    return np.einsum("yxvuc,v,u->yxc", values, weights, weights) / 4.0


def _asked(scene: Scene, depth: int | None = None, *, enough: int | None = None) -> Asked:
    lit = attrs.evolve(scene, draw_lights=True)
    return Asked.of(scene.name, lit, depth, noisy=False, enough=enough)
