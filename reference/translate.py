"""Scene -> Mitsuba: one function per class of the scene model, all lengths at one canonical scale.

Mitsuba's float32 ray offset is `(1 + max |p|) * 8.9e-5`, an absolute length: ambient occlusion is 9 % off in a scene of
size 1e-3 or 1e3 away from the origin. So every scene is centred and scaled by a power of two to a bounding box of 50 to
100 units. Radiance does not change under scaling; the intensity of a point light scales with the square of the scale.

`describe` returns plain numbers, strings and lists only, with meshes and textures as files beside it: what is
rendered here is what `reference.export` writes out.
"""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, get_args

import attrs
import numpy as np

from termwise.scenes.meshes import ply
from termwise.scenes.model import (
    Color,
    DirectionalLight,
    Light,
    Material,
    Mesh,
    Object,
    PointLight,
    Scene,
    SphereLight,
    SpotLight,
    SunLight,
    largest,
)
from termwise.scenes.textures import Texture, downwards, of_two_at_least

Role = Literal[
    "color",
    "diffuse",
    "ambient",
    "direct",
    "specular",
    "physical-lights",
    "physical-sky",
    "physical",
    "transmission",
    "chain",
]
TRANSPARENT: tuple[Role, ...] = "transmission", "chain"
"""Roles that a scene without a transparent surface has no need of: the one would be black, the other `specular`."""

MANY = 64  # objects beyond which those of one look are one shape
SIZE = 100.0  # the largest side of the canonical bounding box is in (SIZE / 2, SIZE]
SMALLEST = 1e-3  # size of an object in a scene of extent 1
BRIGHTEST = 1e15  # radiance or intensity
NARROWEST = 1.0  # degrees of a spot light's cutoff
LONGEST = 2**22  # texels along a face: where two corners lie so far apart, float32 knows a place between to half of one
UNBOUNDED = 1e30  # stands for an infinite range, which JSON does not have
BLACK_BSDF = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.0, 0.0, 0.0]}}


@attrs.frozen
class Canonical:
    """The similarity `p -> (p - centre) * scale` to the canonical scale."""

    centre: np.ndarray
    scale: float

    @classmethod
    def of(cls, scene: Scene) -> "Canonical":
        """Centre the bounding box; scale it by the power of two that brings its largest side into (50, 100]."""
        low, high = scene.bounds()
        extent = float(np.max(high - low))
        return cls((low + high) / 2.0, 2.0 ** math.floor(math.log2(SIZE / extent)) if extent > 0 else 1.0)

    def points(self, points: Any) -> np.ndarray:
        """Move points (..., 3) to the canonical scale, float64."""
        return (np.asarray(points, np.float64) - self.centre) * self.scale


def describe(scene: Scene, folder: Path) -> dict[str, Any]:
    """Everything that the references of a scene are rendered from, at the canonical scale.

    Parameters
    ----------
    scene : the scene.
    folder : existing folder that receives the meshes (PLY), and the sky's and the surfaces' images (NPY).

    Returns
    -------
    A value that JSON can hold: the camera, the settings of the integrators, and under `scenes` one Mitsuba
    dictionary per role. File names in it are relative to `folder`.
    """
    canonical = Canonical.of(scene)
    _check_sizes(scene)
    _check_radiances(scene)
    _check_angles(scene)
    _check_images(scene)
    shapes, parts = gathered(scene)
    for number, thing in enumerate(shapes):
        points = canonical.points(thing.mesh.vertices)
        ply.write(folder / _mesh_file(number), points, thing.mesh.normals, thing.mesh.faces, uv=_uv(thing))
        for image in thing.images.values():
            np.save(folder / _image_file(image), of_two_at_least(image.texels))
    if scene.sky.texture is not None:
        np.save(folder / "sky.npy", scene.sky.texture)
    return {
        "scale": canonical.scale,
        "camera": _camera(scene, canonical),
        "ambient": {
            # Of a textured sky it is the sky's own, see `terms.ambient`.
            "color": None if scene.ambient_light is None else list(scene.ambient_light),
            "range": min(scene.occlusion_range * canonical.scale, UNBOUNDED),
        },
        "sky": _sky(scene, canonical),
        "irradiance_factor": scene.irradiance_factor,
        "ignore": scene.ignore,
        "normals": scene.normals,
        "translucent": bool(scene.translucent),
        "transparent": bool(scene.transparent),
        "passing": _passing(scene, shapes),
        "max_bounces": scene.max_bounces if scene.toggles.reflections or scene.transparent else 0,
        "has_lights": scene.has_lights,
        "diffuse": [
            *(list(scene.diffuse_weight(thing.surface)) for thing in shapes),
            *([0.0] * 3 for _ in scene.spheres),
        ],
        "varying": [list(scene.diffuse_weight(thing.surface)) if thing.surface.textures else None for thing in shapes],
        "reflected": {role: _reflected(scene, role) for role in _roles(scene)},
        "light_centres": [
            [canonical.points(centre).tolist(), *_place(parts, thing, len(scene.objects))]
            for centre, thing in scene.light_centres
        ],
        "suns": _suns(scene),
        "emission": [
            list(largest(radiance)) if scene.shows_lights else [0.0] * 3
            for radiance in (*(thing.emission for thing in shapes), *(sphere.radiance for sphere in scene.spheres))
        ],
        "lamp_means": [_mean_radiance(thing) for thing in shapes],
        "parts": parts,
        "scenes": {role: _scene(scene, shapes, role, canonical) for role in _roles(scene)},
    }


def _passing(scene: Scene, shapes: tuple[Object, ...]) -> list[list[float]]:
    """What each shape leaves of the light on shadow rays; nothing where all shapes occlude."""
    if not scene.unshadowing:
        return []
    of_shapes = [list(scene.passing_weight(thing.surface)) for thing in shapes]
    return of_shapes + [[0.0] * 3 for _ in scene.spheres]


def _roles(scene: Scene) -> list[Role]:
    return [role for role in get_args(Role) if scene.transparent or role not in TRANSPARENT]


def gathered(scene: Scene) -> tuple[tuple[Object, ...], list[list[list[int]]]]:
    """What Mitsuba has as shapes: the objects; where they are many, those of one look as one.

    Mitsuba traces every shape into every kernel: 1000 lamps took half a minute a replicate. Few objects are left as
    they are, and so are those of a scene whose rays pass their own object.

    Returns
    -------
    shapes : an object each.
    parts : of each shape, `[object, number of faces]` of the objects that it holds, in the order of its faces.
    """
    looks: dict[Any, list[int]] = {}
    for number, thing in enumerate(scene.objects):
        flat = thing.mesh.normals is None or thing.emits
        apart = number if len(scene.objects) <= MANY or scene.ignore == "object" else None
        looks.setdefault((apart, thing.surface, thing.emission, flat), []).append(number)
    shapes = [_as_one([scene.objects[number] for number in numbers]) for numbers in looks.values()]
    parts = [[[number, len(scene.objects[number].mesh.faces)] for number in numbers] for numbers in looks.values()]
    return tuple(shapes), parts


def _as_one(things: list[Object]) -> Object:
    """Objects of one look as one, vertex for vertex."""
    if len(things) == 1:
        return things[0]
    first = np.cumsum([0, *(len(thing.mesh.vertices) for thing in things[:-1])])
    vertices = np.concatenate([thing.mesh.vertices for thing in things])
    faces = np.concatenate([thing.mesh.faces + start for thing, start in zip(things, first, strict=True)])
    normals = [thing.mesh.normals for thing in things if thing.mesh.normals is not None]
    smooth = len(normals) == len(things)
    uv = np.concatenate([thing.mesh.uv for thing in things]) if things[0].images else None  # type: ignore[misc]
    return attrs.evolve(things[0], mesh=Mesh(vertices, faces, np.concatenate(normals) if smooth else None, uv))


def _mean_radiance(thing: Object) -> list[float] | None:
    """Of a lamp under an image; None of any other object."""
    return list(thing.mean_radiance()) if thing.emits and isinstance(thing.emission, Texture) else None


def _place(parts: list[list[list[int]]], thing: int, objects: int) -> tuple[int, int, int]:
    """Shape of an object, its first face there, and the one behind its last; -1 of none. Spheres are the last ones."""
    if thing >= objects:
        return len(parts) + thing - objects, 0, 1
    for shape, held in enumerate(parts):
        first = 0
        for number, count in held:
            if number == thing:
                return shape, first, first + count
            first += count
    return -1, 0, 0


def _reflected(scene: Scene, role: Role) -> float:
    """The largest share of light, in any channel, that a surface of a role sends on, or a bound of it."""
    glossy = role not in ("color", "diffuse", "ambient", "direct")
    surfaces = [thing.surface for thing in scene.objects]
    # What is not reflected goes through: the larger of the two bounds both.
    shares = [
        max(scene.diffuse_weight(each)) + glossy * max(scene.specular_weight(each), *scene.transmission_weight(each))
        for each in surfaces
    ]
    return max(shares, default=0.0)


def _check_sizes(scene: Scene) -> None:
    """Refuse a scene that single precision cannot hold.

    Mitsuba's ray offset is 9e-5 of the scene's extent. An object of 1e-5 of it had 5 % of its ambient occlusion wrong
    (measured), and the error is in proportion: 0.05 % at the bound.
    """
    low, high = scene.bounds()
    extent = float(np.max(high - low))
    sizes = {}
    for thing in scene.objects:
        corners = thing.mesh.vertices[thing.mesh.faces].reshape(-1, 3)
        sizes[f"object {thing.name!r}"] = float(np.max(corners.max(axis=0) - corners.min(axis=0)))
    for number, light in enumerate(scene.lights):
        if isinstance(light, SphereLight):
            sizes[f"the sphere lights[{number}]"] = 2.0 * light.radius
    for name, size in sizes.items():
        if size < SMALLEST * extent:
            raise ValueError(
                f"{scene.name}: {name} is {size:g} long in a scene of {extent:g}: allowed is at least {SMALLEST:g} of "
                "it, for Mitsuba computes in single precision; bring far or large objects nearer"
            )


def _check_radiances(scene: Scene) -> None:
    """Refuse light whose square, and hence a variance, single precision cannot hold."""
    named: list[tuple[str, Any]] = [("ambient.color", scene.ambient.color), ("sky.color", scene.sky.color)]
    named += [
        (f"lights[{number}].{light.sends}", getattr(light, light.sends)) for number, light in enumerate(scene.lights)
    ]
    if scene.shows_lights:
        suns = ((number, light) for number, light in enumerate(scene.lights) if isinstance(light, SunLight))
        named += [(f"lights[{number}]: radiance of the drawn disc", light.radiance) for number, light in suns]
    named += [(f"objects: {thing.name!r}: emission", largest(thing.emission)) for thing in scene.objects]
    if scene.sky.texture is not None:
        named.append(("sky.texture", float(scene.sky.texture.max())))
    for name, value in named:
        if np.max(value) > BRIGHTEST:
            raise ValueError(
                f"{scene.name}: {name} = {value}: allowed is at most {BRIGHTEST:g}, for Mitsuba computes in single "
                "precision; ours alone renders it"
            )


def _check_angles(scene: Scene) -> None:
    """Refuse a spot light whose falloff single precision cannot hold: Mitsuba takes the angle from its cosine."""
    for number, light in enumerate(scene.lights):
        if isinstance(light, SpotLight) and light.cutoff < NARROWEST:
            raise ValueError(
                f"{scene.name}: lights[{number}].cutoff = {light.cutoff}: allowed is at least {NARROWEST:g}, for "
                "Mitsuba computes in single precision; ours alone renders it"
            )


def _check_images(scene: Scene) -> None:
    """Refuse an image of so many texels along a face that single precision cannot tell them apart."""
    for thing in scene.objects:
        places = _uv(thing)
        if places is None:
            continue
        for name, image in thing.images.items():
            along = np.ptp(places, axis=1).max(axis=0) * image.texels.shape[1::-1]
            if along.max() > LONGEST:
                raise ValueError(
                    f"{scene.name}: objects: {thing.name!r}: {name}: {along.max():.3g} texels lie along one face: "
                    f"allowed are at most {LONGEST}, for Mitsuba computes in single precision; ours alone renders it"
                )


def _uv(thing: Object) -> np.ndarray | None:
    """Where in an image the faces' corners lie (F, 3, 2), v downwards; None without an image.

    Of an image that repeats, the next to the origin, for what Mitsuba reads is float32.
    """
    images = thing.images.values()
    if not images or thing.mesh.uv is None:
        return None
    places = downwards(thing.mesh.uv)
    repeats = all(image.wrap == "repeat" for image in images)
    return places - np.floor(places.min(axis=1, keepdims=True)) if repeats else places


def _scene(scene: Scene, shapes: tuple[Object, ...], role: Role, canonical: Canonical) -> dict[str, Any]:
    """The same shapes in every role; lights only where the role has them."""
    lit = role in ("direct", "physical-lights", "physical") and scene.has_lights
    described: dict[str, Any] = {"type": "scene", "embree_use_robust_intersections": True}
    for number, thing in enumerate(shapes):
        described[f"object{number}"] = _object(scene, thing, number, role, lit)
    for number, sphere in enumerate(scene.spheres):
        described[f"sphere{number}"] = _sphere(sphere, canonical, lit)
    if lit:
        for number, light in enumerate(scene.lights):
            if not isinstance(light, SphereLight):
                described[f"light{number}"] = _LIGHTS[type(light)](light, scene, canonical)
    if role == "ambient" and math.isinf(scene.occlusion_range) and scene.ambient_light is not None:
        described["sky"] = {"type": "constant", "radiance": _rgb(scene.ambient_light)}
    if role in ("physical-sky", "physical") and not scene.sky.is_black:
        described["sky"] = _sky_emitter(scene, canonical)
    return described


def _object(scene: Scene, thing: Object, number: int, role: Role, lit: bool) -> dict[str, Any]:
    # An emitter is flat: Mitsuba would put interpolated normals into the area measure of light sampling.
    flat = thing.mesh.normals is None or thing.emits
    described: dict[str, Any] = {
        "type": "ply",
        "filename": _mesh_file(number),
        "face_normals": flat,
        "bsdf": _bsdf(scene, thing.surface, role),
    }
    if lit and thing.emits:
        described["emitter"] = _face(thing)
    return described


def _bsdf(scene: Scene, material: Material, role: Role) -> dict[str, Any]:
    """The lobe or lobes of a role on both sides, their weights inside; black where the weight is 0."""
    if role == "color":
        return _diffuse(material, _color(material.color))
    if role in ("diffuse", "ambient", "direct"):
        return _diffuse(material, _diffuse_part(scene, material))
    if material.transparency > 0.0:
        return _transparent(scene, material, role)
    gloss = scene.specular_weight(material)
    if role in ("specular", "transmission", "chain"):
        return _twosided(_lobe(scene, material) if gloss > 0 and role != "transmission" else BLACK_BSDF)
    if gloss == 0:
        return _diffuse(material, _diffuse_part(scene, material))
    factor = _number(material.gloss)
    diffuse, lobe = _color(material.color), _lobe(scene, material) | {"factor": 1.0}
    if material.translucency > 0.0:  # each part says both sides itself
        parts = {"first": _diffuse(material, diffuse), "second": _twosided(lobe)}
        return {"type": "blendbsdf", "weight": factor, **parts}
    first = {"type": "diffuse", "reflectance": diffuse}
    return _twosided({"type": "blendbsdf", "weight": factor, "first": first, "second": lobe})


def _lobe(scene: Scene, material: Material) -> dict[str, Any]:
    """The lobe of an opaque surface, seen from outside."""
    described = {
        "alpha": _number(material.roughness),
        "factor": _number(material.gloss if scene.toggles.reflections else 0.0),
    }
    if material.dielectric:
        return _dielectric(material) | described
    return {"type": "cook_torrance", "f0": list(material.f0)} | described


def _dielectric(material: Material) -> dict[str, Any]:
    return {"type": "microfacet_dielectric", "eta": material.ior, "transparency": 0.0, "tint": list(material.tint)}


def _transparent(scene: Scene, material: Material, role: Role) -> dict[str, Any]:
    """What a transparent surface does to light but for the diffuse part, in full transport with it.

    From within its index is the inverse one: it says both sides itself.
    """
    gloss, through = scene.specular_weight(material), material.transparency
    lobes = _dielectric(material) | {"alpha": material.roughness}
    if role in ("specular", "transmission", "chain"):
        factors = {
            "factor": 0.0 if role == "transmission" else gloss,
            "transparency": 0.0 if role == "specular" else through,
        }
        return lobes | factors if any(factors.values()) else _twosided(BLACK_BSDF)
    weight = 1.0 - (1.0 - gloss) * (1.0 - through)
    lobes |= {"factor": gloss / weight, "transparency": through / weight}
    if weight == 1.0:
        return lobes
    first = _diffuse(material, _color(material.color))
    return {"type": "blend", "weight": weight, "first": first, "second": lobes}


def _diffuse(material: Material, reflectance: dict[str, Any]) -> dict[str, Any]:
    """The diffuse part of a weight; `twosided` takes nothing that lets light through."""
    if material.translucency > 0.0:
        return {"type": "translucent", "reflectance": reflectance, "share": material.translucency}
    return _twosided({"type": "diffuse", "reflectance": reflectance})


def _twosided(bsdf: dict[str, Any]) -> dict[str, Any]:
    return {"type": "twosided", "bsdf": bsdf}


def _color(value: Color | Texture) -> dict[str, Any]:
    return _image(value) if isinstance(value, Texture) else _rgb(value)


def _number(value: float | Texture) -> float | dict[str, Any]:
    return _image(value) if isinstance(value, Texture) else value


def _image(image: Texture) -> dict[str, Any]:
    """Mitsuba's own lookup of an image; see `prepare` for its file."""
    return {
        "type": "bitmap",
        "texture": _image_file(image),
        "raw": True,
        "filter_type": "bilinear",
        "wrap_mode": image.wrap,
        "accel": False,  # a GPU would interpolate with 8-bit weights
    }


def _diffuse_part(scene: Scene, material: Material) -> dict[str, Any]:
    """`color (1 - gloss)`."""
    if not {"color", "gloss"} & {*material.textures}:
        return _rgb(scene.diffuse_weight(material))
    less = _number(material.gloss) if scene.toggles.reflections else 0.0
    return {"type": "share", "of": _color(material.color), "less": less}


def _face(thing: Object) -> dict[str, Any]:
    """The light of an emitting object's faces."""
    if isinstance(thing.emission, Texture):
        return {"type": "area", "radiance": {"type": "lamp_image", "of": _image(thing.emission)}}
    return {"type": "area", "radiance": _rgb(thing.emission)}


def _point(light: PointLight, scene: Scene, canonical: Canonical) -> dict[str, Any]:
    """A point light."""
    return {
        "type": "point",
        "position": canonical.points(light.position).tolist(),
        "intensity": _rgb([component * canonical.scale**2 for component in light.intensity]),
    }


def _spot(light: SpotLight, scene: Scene, canonical: Canonical) -> dict[str, Any]:
    """A spot light; `prepare` makes its transformation."""
    beam, cutoff = map(math.degrees, light.angles)
    return {
        "type": "spot",
        "origin": canonical.points(light.position).tolist(),
        "axis": list(light.axis),
        "intensity": _rgb([component * canonical.scale**2 for component in light.intensity]),
        "beam_width": beam,
        "cutoff_angle": cutoff,
    }


def _distant(light: DirectionalLight | SunLight, scene: Scene, canonical: Canonical) -> dict[str, Any]:
    """A disc in the sky, or a point of it."""
    half = light.half_angle if isinstance(light, SunLight) else 0.0
    low, high = canonical.points(scene.bounds())
    return {
        "type": "distant_light",
        "towards": [-component for component in light.way],
        "below": 2.0 * math.sin(half / 2.0) ** 2,
        "flux": [component / math.cos(half / 2.0) ** 2 for component in light.irradiance],
        "box": ((high - low) / 2.0).tolist(),
        "radius": 0.5 * float(np.linalg.norm(high - low)),
    }


def _sphere(sphere: SphereLight, canonical: Canonical, lit: bool) -> dict[str, Any]:
    """A sphere, black in every role, that shines where there are lights."""
    described = {
        "type": "sphere",
        "center": canonical.points(sphere.center).tolist(),
        "radius": sphere.radius * canonical.scale,
        "bsdf": BLACK_BSDF,
    }
    return described | ({"emitter": {"type": "area", "radiance": _rgb(sphere.radiance)}} if lit else {})


# The kinds of light that have no surface, by the words of `renderer.lights`: a function each.
_LIGHTS: dict[type[Light], Callable[[Any, Scene, Canonical], dict[str, Any]]] = {
    PointLight: _point,
    SpotLight: _spot,
    DirectionalLight: _distant,
    SunLight: _distant,
}


def _suns(scene: Scene) -> list[dict[str, Any]]:
    """The discs that are drawn: middle, the chord from there to the edge on the unit sphere, radiance."""
    return [
        {
            "towards": [-component for component in light.way],
            "chord": 2.0 * math.sin(light.half_angle / 2.0),
            "radiance": list(light.radiance),
        }
        for light in scene.drawn_suns
    ]


def _sky(scene: Scene, canonical: Canonical) -> dict[str, Any]:
    return {
        "color": list(scene.sky.color),
        "texture": "sky.npy" if scene.sky.texture is not None else None,
        "center": canonical.points(scene.sky.center).tolist(),
        "radius": min(scene.sky.radius * canonical.scale, UNBOUNDED),
        "projection": scene.sky.projection,
    }


def _sky_emitter(scene: Scene, canonical: Canonical) -> dict[str, Any]:
    """The sky as a light: `constant`, or the paper's sphere itself, so that parallax and filter are its own.

    Where the sphere is infinite, or does not enclose the camera and all geometry and would hide them, the texture is
    looked up by direction, from a sphere a thousand times as large as the scene.
    """
    if scene.sky.texture is None:
        return {"type": "constant", "radiance": _rgb(scene.sky.color)}
    low, high = scene.bounds()
    corners = np.array([[(low, high)[i][0], (low, high)[j][1], (low, high)[k][2]] for i, j, k in np.ndindex(2, 2, 2)])
    inside = np.vstack([corners, scene.camera.position])
    center, radius = canonical.points(scene.sky.center), scene.sky.radius * canonical.scale
    if math.isinf(radius) or np.linalg.norm(canonical.points(inside) - center, axis=1).max() >= radius:
        center, radius = np.zeros(3), 1000.0 * SIZE
    return {
        "type": "sphere",
        "center": center.tolist(),
        "radius": radius,
        "flip_normals": True,
        "bsdf": BLACK_BSDF,
        "emitter": {
            "type": "area",
            "radiance": {
                "type": "paper_sky",
                "texture": "sky.npy",
                "center": center.tolist(),
                "projection": scene.sky.projection,
            },
        },
    }


def _camera(scene: Scene, canonical: Canonical) -> dict[str, Any]:
    """The paper's near plane as `corner + x * across + y * down`, x and y in [0, 1], at unit distance."""
    right, up, forward = scene.camera.frame()
    half = math.tan(math.radians(scene.camera.fov) / 2.0)
    return {
        "origin": canonical.points(scene.camera.position).tolist(),
        "corner": (forward - half * right + half / scene.aspect * up).tolist(),
        "across": (2.0 * half * right).tolist(),
        "down": (-2.0 * half / scene.aspect * up).tolist(),
        "ball": _ball(scene, canonical),
        "pixel": scene.camera.pixel,
        "resolution": list(scene.resolution),
    }


def _ball(scene: Scene, canonical: Canonical) -> float:
    """Radius of the ball about the origin that holds all geometry, where camera rays begin; 0: at the camera.

    A sky's sphere that does not hold the ball may end before it: the sky is then looked up from the camera.
    """
    low, high = canonical.points(scene.bounds())
    radius = float(np.linalg.norm(np.maximum(np.abs(low), np.abs(high))))
    bounded = scene.sky.texture is not None and math.isfinite(scene.sky.radius)
    if bounded and np.linalg.norm(canonical.points(scene.sky.center)) + radius > scene.sky.radius * canonical.scale:
        return 0.0
    return radius


def _rgb(color: Any) -> dict[str, Any]:
    return {"type": "rgb", "value": [float(component) for component in color]}


def _image_file(image: Texture) -> str:
    return f"image-{image.content[:16]}.npy"


def _mesh_file(number: int) -> str:
    return f"object{number}.ply"
