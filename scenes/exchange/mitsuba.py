"""Mitsuba's XML of a scene, in the scene's own units and with its names: full light transport by the `path` integrator.

`reference.export` writes what our references are rendered from, to the bit; this is for a person, and for renderers
that read Mitsuba's XML: plain values and no plugin of ours. It is written without Mitsuba, which need not be installed.
Meshes (PLY) and the sky (OpenEXR) lie in the folder NAME.files beside it.
"""

import functools
import math
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from termwise.scenes.exchange import panorama
from termwise.scenes.exchange.neutral import describe, images_of, reach
from termwise.scenes.images import openexr
from termwise.scenes.meshes import ply
from termwise.scenes.model import Scene
from termwise.scenes.store import write_atomically
from termwise.scenes.textures import downwards, in_color, of_two_at_least

SUFFIX = ".xml"
SAMPLES = 64
RESERVED = ("integrator", "sensor", "sky")
"""Names of what is no object; those of lights have a colon, which is taken from objects."""
SMOOTH = 1e-4
"""The model's least roughness; Mitsuba's smooth plugin says it, for single precision hardly samples such a lobe."""
BRIGHT = 0.9999
"""Of a conductor's reflectance at normal incidence: at 1 its index of refraction is infinite."""
_REACH = 1e-4, 1e4
"""Clipping planes, of the radius of a ball around the camera that holds all geometry: nothing is cut off."""


def write(scene: Scene, path: Path) -> list[str]:
    """Write a scene as Mitsuba's XML; return what it does not say, a sentence each, which stand in its comment too."""
    described = describe(scene)
    names = _names(described)
    missing = described["left_out"] + left_out(described)
    missing += [
        f"objects: {thing['name']!r}: is called {name!r}"
        for thing, name in zip(described["objects"], names, strict=True)
        if thing["name"] != name
    ]
    comment = "\n".join(["", f"{described['name']}, written by Termwise. Not in this file:", *missing, ""])
    write_described(described, scene, path, spp=SAMPLES, comment=comment)
    return missing


def write_described(
    described: dict[str, Any],
    scene: Scene,
    path: Path,
    *,
    spp: int,
    seed: int | None = None,
    depth: int | None = None,
    comment: str = "",
) -> None:
    """Write what is described, lamps that reflect too.

    Parameters
    ----------
    described : as `neutral.describe` has it.
    scene : what was described: its sky and size.
    path : of the XML.
    spp, seed : of the sampler; None: Mitsuba's own.
    depth : how often light may scatter at surfaces; None: any number. A path is one edge longer.
    comment : stands first.
    """
    files = path.with_suffix(".files")
    root = ElementTree.Element("scene", version="3.0.0")
    integrator = _plugin(root, "integrator", "path", id="integrator")
    _value(integrator, "integer", "max_depth", -1 if depth is None else depth + 1)
    _sensor(root, described, reach(scene), spp, seed)
    for number, (thing, name) in enumerate(zip(described["objects"], _names(described), strict=True)):
        mesh = files / f"{number:02d}.ply"
        arrays = thing["vertices"], thing["normals"], thing["faces"], thing.get("uv")
        write_atomically(mesh, functools.partial(_write_mesh, arrays))
        _shape(root, thing, name, files.name, mesh.name)
    for name, image in images_of(scene).items():
        texels = of_two_at_least(in_color(image.texels))
        write_atomically(files / name, functools.partial(openexr.write, pixels=texels))
    for number, light in enumerate(described["lights"]):
        _light(root, light, f"light: {number}")
    sky = described["sky"]
    if sky is not None and sky["type"] == "constant":
        _value(_plugin(root, "emitter", "constant", id="sky"), "rgb", "radiance", _numbers(sky["radiance"]))
    elif sky is not None:
        texels = panorama.latitude_longitude(scene.sky, scene.camera.position)
        write_atomically(files / "sky.exr", lambda temporary: openexr.write(temporary, texels))
        emitter = _plugin(root, "emitter", "envmap", id="sky")
        _value(emitter, "string", "filename", f"{files.name}/sky.exr")
        # Mitsuba's map has +y at the top and -z in the middle.
        place = ElementTree.SubElement(emitter, "transform", name="to_world")
        ElementTree.SubElement(place, "matrix", value="0 0 1 0 1 0 0 0 0 1 0 0 0 0 0 1")
    ElementTree.indent(root)
    text = ElementTree.tostring(root, "unicode") + "\n"
    if comment:
        text = f"<!--{re.sub('-(?=-)', '- ', comment)}-->\n{text}"
    write_atomically(path, lambda temporary: temporary.write_text(text, "utf-8"))


def left_out(described: dict[str, Any]) -> list[str]:
    """What plain Mitsuba cannot say of a scene described."""
    rational = "a rational approximation of Smith's masking"
    found = [
        f"objects: {thing['name']!r}: gloss = {_gloss(thing['material'])}: the lobe has the Fresnel reflectance of "
        f"a dielectric of the same f0, not Schlick's, and {rational}"
        for thing in described["objects"]
        if thing["material"]["gloss"] != 0.0 and "fresnel" not in thing["material"]
    ]
    for thing in described["objects"]:
        if "fresnel" in thing["material"]:
            smooth = thing["material"]["roughness"] == SMOOTH and "transparency" in thing["material"]
            told = "the lobes are perfectly smooth" if smooth else f"the lobes have {rational}"
            found.append(f"objects: {thing['name']!r}: fresnel = 'dielectric': {told}")
    found += [
        f"lights[{number}]: sun: a directional light without a disc"
        for number, light in enumerate(described["lights"])
        if light["type"] == "sun"
    ]
    if described["sky"] is not None and described["sky"]["type"] == "image":
        found.append("sky: resampled as the camera sees it, and infinitely far")
    return found


def _gloss(material: dict[str, Any]) -> str:
    gloss = material["gloss"]
    return "an image" if isinstance(gloss, dict) else repr(gloss)


def _names(described: dict[str, Any]) -> list[str]:
    """Names that Mitsuba takes: it takes no dots, and none may stand twice."""
    found: list[str] = []
    for thing in described["objects"]:
        plain = " ".join(re.sub("[.:]", "_", thing["name"]).split())
        while plain in (*found, *RESERVED):
            plain += "_"
        found.append(plain)
    return found


def _write_mesh(arrays: tuple[Any, Any, Any, Any], path: Path) -> None:
    vertices, normals, faces, uv = (None if each is None else np.array(each) for each in arrays)
    assert vertices is not None
    assert faces is not None
    ply.write(path, vertices, normals, faces, uv=None if uv is None else downwards(uv))


def _sensor(root: ElementTree.Element, described: dict[str, Any], size: float, spp: int, seed: int | None) -> None:
    camera, (width, height) = described["camera"], described["film"]["resolution"]
    sensor = _plugin(root, "sensor", "perspective", id="sensor")
    _value(sensor, "float", "fov", camera["horizontal_fov"])
    _value(sensor, "string", "fov_axis", "x")
    for name, part in zip(("near_clip", "far_clip"), _REACH, strict=True):
        _value(sensor, "float", name, part * size)
    _look(sensor, camera["position"], camera["forward"], camera["up"])
    film = _plugin(sensor, "film", "hdrfilm")
    _value(film, "integer", "width", width)
    _value(film, "integer", "height", height)
    _value(film, "string", "pixel_format", "rgb")
    _value(film, "string", "component_format", "float32")
    _plugin(film, "rfilter", "box")
    sampler = _plugin(sensor, "sampler", "independent")
    _value(sampler, "integer", "sample_count", spp)
    if seed is not None:
        _value(sampler, "integer", "seed", seed)


def _shape(root: ElementTree.Element, thing: dict[str, Any], name: str, folder: str, mesh: str) -> None:
    shape = _plugin(root, "shape", "ply", id=name)
    _value(shape, "string", "filename", f"{folder}/{mesh}")
    _value(shape, "boolean", "face_normals", "true" if thing["normals"] is None else "false")
    _bsdf(shape, thing["material"], folder)
    if any(thing["emission"]):
        _color(_plugin(shape, "emitter", "area"), "radiance", thing["emission"], folder)


def _diffuse(parent: ElementTree.Element, share: float, color: Any, folder: str) -> None:
    """The diffuse part; of `diff_trans`, 2 is all of it, and its transmitted part is Lambert's."""
    if share:
        parent = _plugin(parent, "bsdf", "blendbsdf")
        _value(parent, "float", "weight", share)
    stays = _plugin(parent, "bsdf", "twosided") if share else parent
    _color(_plugin(stays, "bsdf", "diffuse"), "reflectance", color, folder)
    if share:
        crosses = _plugin(parent, "bsdf", "principledthin")
        _color(crosses, "base_color", color, folder)
        _value(crosses, "float", "diff_trans", 2.0)


def _color(parent: ElementTree.Element, name: str, color: Any, folder: str) -> None:
    """Three numbers or an image."""
    if isinstance(color, dict):
        _image(parent, name, color, folder)
    else:
        _value(parent, "rgb", name, _numbers(color))


def _dielectric(parent: ElementTree.Element, material: dict[str, Any], folder: str) -> None:
    """What is transparent: its diffuse part has a share of a blend, and the lobes are larger by what is left of it."""
    gloss, transparency = material["gloss"], material["transparency"]
    diffuse = (1.0 - gloss) * (1.0 - transparency) if any(material["color"]) else 0.0
    if diffuse:
        parent = _plugin(parent, "bsdf", "blendbsdf")
        _value(parent, "float", "weight", 1.0 - diffuse)
        share = material.get("translucency", 0.0)
        _diffuse(parent if share else _plugin(parent, "bsdf", "twosided"), share, material["color"], folder)
    smooth = material["roughness"] == SMOOTH
    lobes = _plugin(parent, "bsdf", "dielectric" if smooth else "roughdielectric")
    if not smooth:
        _value(lobes, "string", "distribution", "beckmann")
        _value(lobes, "float", "alpha", material["roughness"])
    _value(lobes, "float", "int_ior", material["ior"])
    _value(lobes, "float", "ext_ior", 1.0)
    through = [transparency * each / (1.0 - diffuse) for each in material["tint"]]
    _value(lobes, "rgb", "specular_reflectance", _numbers([gloss / (1.0 - diffuse)] * 3))
    _value(lobes, "rgb", "specular_transmittance", _numbers(through))


def _bsdf(parent: ElementTree.Element, material: dict[str, Any], folder: str) -> None:
    if "transparency" in material:
        _dielectric(parent, material, folder)
        return
    share = material.get("translucency", 0.0)
    if not share:
        parent = _plugin(parent, "bsdf", "twosided")  # which takes nothing that lets light through
    if material["gloss"] != 0.0:
        parent = _plugin(parent, "bsdf", "blendbsdf")
        _number(parent, "weight", material["gloss"], folder)
    _diffuse(parent, share, material["color"], folder)
    if material["gloss"] != 0.0:
        parent = _plugin(parent, "bsdf", "twosided") if share else parent
        # A conductor without absorption is a dielectric seen from outside: f0 = ((n - 1) / (n + 1))².
        roots = [math.sqrt(min(f0, BRIGHT)) for f0 in material["f0"]]
        indices = [(1.0 + root) / (1.0 - root) for root in roots]
        lobe = _plugin(parent, "bsdf", "roughconductor")
        _value(lobe, "string", "distribution", "beckmann")
        _number(lobe, "alpha", material["roughness"], folder)
        _value(lobe, "rgb", "eta", _numbers([material["ior"]] * 3 if "ior" in material else indices))
        _value(lobe, "rgb", "k", _numbers((0.0, 0.0, 0.0)))


def _number(parent: ElementTree.Element, name: str, value: float | dict[str, Any], folder: str) -> None:
    if isinstance(value, dict):
        _image(parent, name, value, folder)
    else:
        _value(parent, "float", name, value)


def _image(parent: ElementTree.Element, name: str, image: dict[str, Any], folder: str) -> None:
    """Linear texels as they are; without a GPU's own lookup, whose weights have 8 bits."""
    bitmap = _plugin(parent, "texture", "bitmap", name=name)
    _value(bitmap, "string", "filename", f"{folder}/{image['image']}")
    _value(bitmap, "string", "wrap_mode", image["wrap"])
    _value(bitmap, "boolean", "raw", "true")
    _value(bitmap, "boolean", "accel", "false")


def _light(root: ElementTree.Element, light: dict[str, Any], name: str) -> None:
    if light["type"] == "sphere":
        ball = _plugin(root, "shape", "sphere", id=name)
        _value(ball, "point", "center", _numbers(light["center"]))
        _value(ball, "float", "radius", light["radius"])
        _value(_plugin(ball, "bsdf", "diffuse"), "rgb", "reflectance", _numbers((0.0, 0.0, 0.0)))
        _value(_plugin(ball, "emitter", "area"), "rgb", "radiance", _numbers(light["radiance"]))
        return
    if light["type"] in ("directional", "sun"):
        emitter = _plugin(root, "emitter", "directional", id=name)
        _value(emitter, "vector", "direction", _numbers(light["direction"]))
        _value(emitter, "rgb", "irradiance", _numbers(light["irradiance"]))
        return
    emitter = _plugin(root, "emitter", light["type"], id=name)
    _value(emitter, "rgb", "intensity", _numbers(light["intensity"]))
    if light["type"] == "point":
        _value(emitter, "point", "position", _numbers(light["position"]))
        return
    _look(emitter, light["position"], light["axis"], np.eye(3)[np.argmin(np.abs(light["axis"]))])
    _value(emitter, "float", "beam_width", light["beam"])
    _value(emitter, "float", "cutoff_angle", light["cutoff"])


def _look(parent: ElementTree.Element, position: Any, way: Any, up: Any) -> None:
    place = ElementTree.SubElement(parent, "transform", name="to_world")
    look = {"origin": _numbers(position), "target": _numbers(np.add(position, way)), "up": _numbers(up)}
    ElementTree.SubElement(place, "lookat", look)


def _plugin(parent: ElementTree.Element, tag: str, kind: str, **more: str) -> ElementTree.Element:
    return ElementTree.SubElement(parent, tag, {"type": kind, **more})


def _value(parent: ElementTree.Element, tag: str, name: str, value: object) -> None:
    ElementTree.SubElement(parent, tag, name=name, value=str(value))


def _numbers(values: Any) -> str:
    return ", ".join(repr(float(value)) for value in values)
