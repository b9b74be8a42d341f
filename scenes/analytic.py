"""Scenes with an answer in closed form: what both sides are tested against.

| scene | term | answer |
|---|---|---|
| `furnace` | specular | gloss S[1], the lobe's directional albedo at one cosine |
| `glossy_sphere` | specular | chains in a closed sphere: powers of one operator on functions of the cosine |
| `disc_over_plane` | ambient | AO = h² / (h² + R²) |
| `unit_sphere` | direct | rho I / pi first hit, rho I / (pi (1 - rho)) all; at rho = .5, I = pi: 0.5 and 1.0 |
| `closed_box` | ambient, direct | AO = 0; photons deposit the flux Phi / (1 - rho) in all |
| `rectangle_light` | direct | Lambert's polygonal form factor |

A camera here looks along one ray: its field of view is 1e-3 degrees unless the scene is a closed room. What it sees
lies off the diagonal of the plate: where a point lies on an edge to the last bit, either face may be taken to be hit.
"""

import math

import numpy as np
import trimesh

from termwise.scenes.model import (
    Ambient,
    Camera,
    Color,
    Material,
    Mesh,
    Object,
    Photons,
    PointLight,
    Scene,
    Scope,
    Sky,
    Vector,
)

_ONE_RAY = 1e-3
_GREY = Material()


def _grey(value: float) -> Color:
    return value, value, value


def plate(name: str, corner: Vector, first: Vector, second: Vector, material: Material = _GREY) -> Object:
    """A parallelogram of two triangles; its normal is `first` x `second`."""
    origin, u, v = np.array(corner), np.array(first), np.array(second)
    vertices = np.array([origin, origin + u, origin + u + v, origin + v])
    return Object(name, Mesh.from_arrays(vertices, [[0, 1, 2], [0, 2, 3]]), material)


def sphere_inside(
    name: str, *, subdivisions: int, material: Material, smooth: bool = False, radius: float = 1.0
) -> Object:
    """An icosphere around the origin whose normals point inwards; its vertices lie on the sphere."""
    sphere = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return Object(name, Mesh.from_arrays(sphere.vertices, sphere.faces[:, ::-1], smooth=smooth), material)


def furnace(*, roughness: float, mu_o: float, f0: float = 1.0, gloss: float = 1.0, color: float = 1.0) -> Scene:
    """A plate under a white sky and a white ambient light, seen at cosine `mu_o` of its normal.

    `L_specular = gloss S[1]`, where `S[1] = ∫ f mu_i dw` is the lobe's directional albedo: the whole hemisphere is 1.
    `L_ambient = color (1 - gloss)`: nothing occludes.
    """
    material = Material(_grey(color), gloss, roughness, _grey(f0))
    view = (math.sqrt(1.0 - mu_o * mu_o), 0.0, mu_o)
    return Scene(
        "furnace",
        Camera(view, (0.0, 0.0, 0.0), up=(0.0, 1.0, 0.0), fov=_ONE_RAY, pixel="centre"),
        (plate("plate", (-9.0, -9.0, 0.0), (18.0, 0.0, 0.0), (0.0, 19.0, 0.0), material),),
        ambient=Ambient(_grey(1.0)),
        sky=Sky(_grey(1.0)),
        resolution=(8, 8),
        max_bounces=1,
    )


def glossy_sphere(*, gloss: float, roughness: float, max_bounces: int, subdivisions: int = 3) -> Scene:
    """The inside of a closed unit sphere, F0 = 1, seen from its centre; the ambient light is 1 within 1e-3.

    Every chord meets the sphere at equal angles at both ends, so with `T` the operator
    `(T v)(mu_o) = ∫ f mu_i v(mu_i) dw` a chain of up to M vertices is
    `L_specular = (1 - gloss) sum_{j=1..M} (gloss T)^j 1` at mu_o = 1, and `k T` in place of `T` for a lobe k times too
    bright. The facets of the tessellation turn normals by 0.02 rad (subdivisions = 3).
    """
    material = Material(_grey(1.0), gloss, roughness, _grey(1.0))
    return Scene(
        "glossy_sphere",
        Camera((0.0, 0.0, 0.0), (0.0, 1.0, 0.0), fov=90.0),
        (sphere_inside("sphere", subdivisions=subdivisions, material=material),),
        ambient=Ambient(_grey(1.0), range=1e-3),
        resolution=(32, 32),
        max_bounces=max_bounces,
    )


def disc_over_plane(*, height: float, radius: float, sides: int = 64, occlusion_range: float = math.inf) -> Scene:
    """A disc parallel to a white plate, seen at the point below its centre.

    `AO = h² / (h² + R²)`; with a range r between h and the disc's rim `AO = h² / r²`, and 1 for r < h.
    The disc is a regular polygon of circumradius R: Lambert's formula gives its exact AO,
    `1 - n atan(R sin(pi/n) / q) a / (pi q)`, `a = R cos(pi/n)`, `q² = h² + a²`.
    """
    angle = 2.0 * math.pi * np.arange(sides) / sides
    rim = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(sides, height)], axis=-1)
    vertices = np.concatenate([[[0.0, 0.0, height]], rim])
    step = np.arange(sides)
    faces = np.stack([np.zeros(sides, int), 1 + step, 1 + (step + 1) % sides], axis=-1)
    return Scene(
        "disc_over_plane",
        # From the side, below the disc.
        Camera((8.0 * height, 0.3 * height, 0.4 * height), (0.0, 0.0, 0.0), fov=_ONE_RAY, pixel="centre"),
        (
            plate(
                "plate",
                (-20.0 * height, -21.0 * height, 0.0),
                (41.0 * height, 0.0, 0.0),
                (0.0, 42.0 * height, 0.0),
                Material(_grey(1.0)),
            ),
            Object("disc", Mesh.from_arrays(vertices, faces)),
        ),
        ambient=Ambient(_grey(1.0), range=occlusion_range),
        resolution=(8, 8),
    )


def unit_sphere(
    *, albedo: float = 0.5, intensity: float = math.pi, subdivisions: int = 3, scope: Scope = "all"
) -> Scene:
    """The inside of a closed unit sphere with a point light at its centre, seen from there.

    First hit: `E = I`, so `L_direct = rho I / pi`. All: what leaves a point arrives everywhere alike,
    `L_direct = rho I / (pi (1 - rho))`. On the tessellated sphere E of the first hit is `I cos(theta) / d²` of the
    facet, and E of all bounces lies between its extremes, divided by 1 - rho.
    """
    material = Material(_grey(albedo))
    return Scene(
        "unit_sphere",
        Camera((0.0, 0.0, 0.0), (0.0, 1.0, 0.0), fov=90.0, pixel="centre"),
        (sphere_inside("sphere", subdivisions=subdivisions, material=material),),
        lights=(PointLight((0.0, 0.0, 0.0), _grey(intensity)),),
        photons=Photons(count=20_000, radius=0.2),
        resolution=(16, 16),
        scope=scope,
    )


def closed_box(*, albedo: float = 0.5, intensity: float = 1.0) -> Scene:
    """The inside of a closed cube of side 2 with a point light off its centre.

    With an unlimited range AO = 0. Nothing leaves, so the photons that land carry `4 pi I / (1 - rho)` in all,
    and the light's own share of it, `4 pi I`, lands at the first hit.
    """
    box = trimesh.creation.box(extents=(2.0, 2.0, 2.0))
    material = Material(_grey(albedo))
    return Scene(
        "closed_box",
        Camera((-0.6, -0.7, 0.1), (0.5, 0.6, -0.2), fov=80.0),
        (Object("box", Mesh.from_arrays(box.vertices, box.faces[:, ::-1]), material),),
        lights=(PointLight((0.3, -0.2, 0.4), _grey(intensity)),),
        ambient=Ambient(_grey(1.0)),
        photons=Photons(count=20_000, radius=0.3),
        resolution=(16, 16),
    )


def rectangle_light(*, width: float, depth: float, height: float, radiance: float = 1.0) -> Scene:
    """A rectangle that emits downwards at `height` over a white plate, one corner over the point that is seen.

    `L_direct = L F`, F the form factor of a rectangle from below its corner: with `X = width / height` and
    `Y = depth / height`,
    `2 pi F = X / sqrt(1 + X²) atan(Y / sqrt(1 + X²)) + Y / sqrt(1 + Y²) atan(X / sqrt(1 + Y²))`.
    Source: Howell, "A Catalog of Radiation Heat Transfer Configuration Factors", factor B-4.
    """
    lamp = plate("lamp", (0.0, 0.0, height), (0.0, depth, 0.0), (width, 0.0, 0.0))
    return Scene(
        "rectangle_light",
        Camera((-3.0, -4.0, 2.0), (0.0, 0.0, 0.0), fov=_ONE_RAY, pixel="centre"),
        (
            plate("plate", (-9.0, -9.0, 0.0), (18.0, 0.0, 0.0), (0.0, 19.0, 0.0), Material(_grey(1.0))),
            Object("lamp", lamp.mesh, emission=_grey(radiance)),
        ),
        resolution=(8, 8),
        scope="first-hit",
    )
