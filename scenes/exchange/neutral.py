"""The neutral scene file: JSON that says all that a renderer of light transport must know, in the scene's own units.

An adapter reads it with a JSON library alone. `neutral.schema.json` says each field with its unit; so do the
`conventions` in the file itself. What it holds is full light transport, the terms of `physical` and the background;
the paper's settings that mean nothing there are named in `left_out`.
"""

import functools
import json
import math
from pathlib import Path
from typing import Any

import attrs
import numpy as np

from termwise.scenes.images import openexr
from termwise.scenes.model import (
    DirectionalLight,
    Light,
    Object,
    PointLight,
    Scene,
    Sky,
    SphereLight,
    SpotLight,
    SunLight,
    shines,
)
from termwise.scenes.store import write_atomically
from termwise.scenes.textures import Texture, in_color

FORMAT = "termwise-neutral"
PLAIN, OF_IMAGES, OF_DIELECTRICS = 1, 2, 3
"""The version is that of the oldest reader who understands the file: 2 with an image or what is translucent, 3 with a
dielectric, else 1."""
SUFFIX = ".json"
SCHEMA = Path(__file__).with_name("neutral.schema.json")
CONVENTIONS = {
    "length": "the scene's own unit; axes are right-handed",
    "color": "linear Rec. 709 (sRGB primaries, D65); radiance in one linear unit per channel",
    "camera": "a pinhole: the film point (x, y) in [0, 1]^2, (0, 0) its top left corner, y down, is seen along "
    "forward + (2 x - 1) t right + (1 - 2 y) t (height / width) up, with t = tan(horizontal_fov / 2)",
    "film": "first row at the top, first column at the left; a pixel is the mean over its own area (box filter)",
    "face": "its front is the side that (v1 - v0) x (v2 - v0) points to; surfaces are two-sided",
    "normals": "unit shading normals at the vertices, interpolated; null: the face's own",
    "material": "f = (1 - gloss) color / pi + gloss F D G / (4 cos_i cos_o): F = f0 + (1 - f0) (1 - cos)^5, "
    "D Beckmann's with alpha = roughness, G = G1(i) G1(o) Smith's exact",
    "image": "in the place of a colour, or grey of a number, of a material, or of an emission: linear, bilinear "
    "between centres of texels, of the uv of the face's corners: (0, 0) is the lower left corner of the image, v "
    "upwards; beyond [0, 1] it repeats, or with wrap clamp its border goes on; a sample is the value at one point",
    "translucency": "where a material has it, s: color is divided, (1 - s) color / pi for light of the viewer's side, "
    "s color / pi for light of the other side, which crosses the surface; without, s is 0",
    "fresnel": "of a material that has fresnel = dielectric F is that of a smooth surface between two media, "
    "unpolarised, of the index ior: inside over outside, the side that the normal points to; total reflection included",
    "transparency": "of such a material, t: f = (1 - gloss) (1 - t) color / pi + gloss f_r + t tint f_t, both lobes of "
    "the same microfacets, f_t Walter's (EGSR 2007) of the 1 - F that they do not reflect, of radiance, which is eta^2 "
    "times as much in a medium of the index eta; without, t is 0, and both sides are outside",
    "emission": "radiance that leaves the front of the faces; the back of a lamp is black, and neither side reflects",
    "point": "intensity is radiant intensity, radiance x area, per steradian: a surface at distance d that faces the "
    "light has the irradiance intensity / d^2",
    "spot": "a point light whose intensity is full up to the angle beam from its axis (degrees), falls linearly in the "
    "angle to 0 at cutoff, and is 0 beyond",
    "directional": "light that flies along direction: irradiance of a surface that faces it; it is not seen",
    "sun": "a disc infinitely far, of the diameter angle (degrees) and radiance irradiance / (pi sin^2(angle / 2)), "
    "the light of whose middle flies along direction",
    "sphere": "a ball whose outside has the same radiance everywhere, and a black surface; it hides what is behind",
    "sky": "radiance that comes from where a ray meets nothing; an image lies on a sphere, seen from within: "
    "n from its center to the ray's farther hit, u = atan2(n.x, n.y) / (2 pi) + 1/2, v = 1/2 - n.z / 2 (equal-area) or "
    "v = acos(n.z) / pi (lat-long), first row at v = 0; radius null: infinite, n is the ray's direction",
}


def diffuse(scene: Scene) -> Scene:
    """The scene with every gloss, translucency and transparency 0: what every format and renderer can say exactly."""

    def plain(thing: Object) -> Object:
        none = {"gloss": 0.0, "translucency": 0.0, "transparency": 0.0, "fresnel": "auto", "occludes": True}
        return attrs.evolve(thing, material=attrs.evolve(thing.material, **none))

    return attrs.evolve(scene, objects=tuple(map(plain, scene.objects)))


def describe(scene: Scene, *, sky_file: str = "sky.exr") -> dict[str, Any]:
    """A scene as `neutral.schema.json` says it, arrays as nested lists of Python's numbers.

    Parameters
    ----------
    scene : the scene; its objects keep their names, order, units and place.
    sky_file : name that the sky's image is given, where it has one.
    """
    right, up, forward = scene.camera.frame()
    lit = scene.toggles.lighting
    there = {
        "image": bool(images_of(scene)),
        "translucency": bool(scene.translucent),
        "fresnel": any(thing.surface.dielectric for thing in scene.objects),
        "transparency": bool(scene.transparent),
    }
    unused = {name for name, used in there.items() if not used}
    later = OF_IMAGES if there["image"] or there["translucency"] else PLAIN
    return {
        "format": FORMAT,
        "version": OF_DIELECTRICS if there["fresnel"] else later,
        "name": scene.name,
        "conventions": {name: text for name, text in CONVENTIONS.items() if name not in unused},
        "left_out": left_out(scene),
        "film": {"resolution": list(scene.resolution), "filter": "box", "first_row": "top"},
        "camera": {
            "position": list(scene.camera.position),
            "right": right.tolist(),
            "up": up.tolist(),
            "forward": forward.tolist(),
            "horizontal_fov": scene.camera.fov,
        },
        "objects": [_object(scene, thing, lit) for thing in scene.objects],
        "lights": [_light(light) for light in scene.lights if lit and shines(light)],
        "sky": _sky(scene.sky, sky_file),
    }


def images_of(scene: Scene) -> dict[str, Texture]:
    """The images of all surfaces by the names of their files, which are named by what they hold."""
    images = (image for thing in scene.objects for image in thing.images.values())
    return {_image_file(image): image for image in images}


def _image_file(image: Texture) -> str:
    return f"image-{image.content[:16]}.exr"


def refuse_images(scene: Scene, what: str) -> None:
    """Refuse a scene with an image on a surface, for a format that is written without."""
    for thing in scene.objects:
        for name in thing.images:
            raise ValueError(
                f"{scene.name}: objects: {thing.name!r}: {name}: is an image, and {what} is written without: allowed "
                "are neutral and mitsuba"
            )


def _said(value: Any) -> Any:
    """A field of a material, or an emission."""
    if isinstance(value, Texture):
        return {"image": _image_file(value), "wrap": value.wrap}
    return list(value) if isinstance(value, tuple) else value


def _object(scene: Scene, thing: Object, lit: bool) -> dict[str, Any]:
    surface = thing.surface if scene.toggles.reflections else attrs.evolve(thing.surface, gloss=0.0)
    mapped = {"uv": thing.mesh.uv.tolist()} if thing.mesh.uv is not None and thing.images else {}
    # An older reader is told of nothing that he would not understand.
    unsaid = ["occludes"] + ([] if thing in scene.translucent else ["translucency"])
    unsaid += [] if surface.transparency > 0.0 else ["transparency", "tint"]
    unsaid += [] if surface.dielectric else ["fresnel", "ior"]
    said = [field.name for field in attrs.fields(type(surface)) if field.name not in unsaid]
    surface = attrs.evolve(surface, fresnel="dielectric") if surface.dielectric else surface
    return {
        "name": thing.name,
        "vertices": thing.mesh.vertices.tolist(),
        "faces": thing.mesh.faces.tolist(),
        "normals": None if thing.mesh.normals is None or thing.emits else thing.mesh.normals.tolist(),
        "material": {name: _said(getattr(surface, name)) for name in said},
        "emission": _said(thing.emission) if lit and thing.emits else [0.0, 0.0, 0.0],
        **mapped,
    }


def _light(light: Light) -> dict[str, Any]:
    """A light that is no object's, by its kind."""
    match light:
        case PointLight():
            where = {"position": list(light.position)}
        case SpotLight():
            beam, cutoff = map(math.degrees, light.angles)
            where = {"position": list(light.position), "axis": list(light.axis), "beam": beam, "cutoff": cutoff}
        case DirectionalLight():
            where = {"direction": list(light.way)}
        case SunLight():
            where = {"direction": list(light.way), "angle": light.angle}
        case SphereLight():
            where = {"center": list(light.center), "radius": light.radius}
    return {"type": light.kind, **where, light.sends: list(getattr(light, light.sends))}


def _sky(sky: Sky, file: str) -> dict[str, Any] | None:
    if sky.is_black:
        return None
    if sky.texture is None:
        return {"type": "constant", "radiance": list(sky.color)}
    radius = sky.radius if math.isfinite(sky.radius) else None
    return {"type": "image", "file": file, "projection": sky.projection, "center": list(sky.center), "radius": radius}


def reach(scene: Scene) -> float:
    """Radius of a ball around the camera that holds all geometry; 1 where there is none."""
    low, high = np.abs(np.subtract(scene.bounds(), scene.camera.position))
    return float(np.linalg.norm(np.maximum(low, high))) or 1.0


def left_out(scene: Scene) -> list[str]:
    """What a scene says and full light transport, as other renderers compute it, does not: field, value and why."""
    lamps = [thing.name for thing in scene.objects if thing.emits] if scene.has_lights else []
    dark = [] if scene.toggles.lighting else [*scene.spheres]
    dark += [light for light in scene.spheres if not shines(light)]
    seen = [light.kind for light in scene.lights if isinstance(light, SunLight | SphereLight) and shines(light)]
    lamps += [f"the {kind}" for kind in dict.fromkeys(seen) if scene.toggles.lighting]
    found = [
        *((True, "lights", light, "a sphere that does not shine hides nothing") for light in dark),
        *(
            (True, f"objects: {thing.name!r}: occludes", False, "light comes through refracted, and leaves a shadow")
            for thing in scene.unshadowing
        ),
        (any(scene.ambient.color), "ambient", scene.ambient.color, "the paper's ambient light is no light transport"),
        (scene.ambient.source == "sky", "ambient.source", "sky", "the sky lights all surfaces, and they each other"),
        (bool(lamps) and not scene.draw_lights, "draw_lights", False, f"the camera sees {', '.join(lamps)} shine"),
        (scene.scope == "first-hit", "scope", scene.scope, "light scatters at all surfaces"),
        (scene.shadows == "paper", "shadows", scene.shadows, "visibility alone decides"),
        (scene.irradiance == "E", "irradiance", scene.irradiance, "irradiance is divided by pi"),
        (scene.ignore == "object", "ignore", scene.ignore, "objects shadow themselves"),
        (scene.normals == "face", "normals", scene.normals, "surfaces are two-sided"),
        (scene.intersection == "paper", "intersection", scene.intersection, "rays meet triangles exactly"),
        (scene.camera.pixel != "jitter", "camera.pixel", scene.camera.pixel, "the filter is a box"),
    ]
    return [f"{name} = {value!r}: {why}" for there, name, value, why in found if there]


def write(scene: Scene, path: Path) -> list[str]:
    """Write the neutral file of a scene; return what it does not say, as its `left_out`."""
    write_neutral(scene, path)
    return left_out(scene)


def write_neutral(scene: Scene, path: Path) -> Path:
    """Write the neutral file of a scene, and its sky's image beside it.

    Parameters
    ----------
    scene : the scene.
    path : a name that ends in .json, or a folder, where the file is NAME.json.

    Returns
    -------
    The JSON file, which appears last and whole. The image of a sky is NAME.sky.exr beside it: OpenEXR, three channels
    of float32, named in the file without a folder; so are those of surfaces.
    """
    file = path if path.suffix == SUFFIX else path / f"{scene.name}{SUFFIX}"
    sky = f"{file.stem}.sky.exr"
    described = describe(scene, sky_file=sky)
    texture = scene.sky.texture
    if described["sky"] is not None and texture is not None:
        write_atomically(file.with_name(sky), lambda temporary: openexr.write(temporary, texture))
    write_images(scene, file.parent)
    write_atomically(file, lambda temporary: temporary.write_text(_text(described), "utf-8"))
    return file


def write_images(scene: Scene, folder: Path) -> None:
    """Write the images of surfaces, an OpenEXR file each."""
    for name, image in images_of(scene).items():
        write_atomically(folder / name, functools.partial(openexr.write, pixels=in_color(image.texels)))


def _text(described: dict[str, Any]) -> str:
    """JSON with a line for each field, object and light: a file that can be looked at, and compared by lines."""
    lines = []
    for name, value in described.items():
        if name in ("objects", "lights", "left_out") and value:
            text = "[\n  " + ",\n  ".join(json.dumps(item, allow_nan=False) for item in value) + "\n ]"
        else:
            text = json.dumps(value, allow_nan=False)
        lines.append(f" {json.dumps(name)}: {text}")
    return "{\n" + ",\n".join(lines) + "\n}\n"
