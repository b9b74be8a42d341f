"""Mitsuba's XML of a scene, in the scene's own units and with its names: full light transport by the `path` integrator.

`reference.export` writes what our references are rendered from, to the bit; this is for a person, and for renderers
that read Mitsuba's XML. Meshes (PLY) and the sky (OpenEXR) lie in the folder NAME.files beside it.
"""

import math
import re
from pathlib import Path
from typing import Any

import attrs
import numpy as np

from termwise.reference import backend, translate
from termwise.scenes.exchange import panorama
from termwise.scenes.exchange.neutral import describe, reach
from termwise.scenes.images import openexr
from termwise.scenes.model import Object, Scene
from termwise.scenes.store import write_atomically

SUFFIX = ".xml"
RESERVED = ("type", "integrator", "sensor", "sky")
"""Names of what is no object; those of lights have a colon, which is taken from objects."""
BRIGHT = 0.9999
"""Of a conductor's reflectance at normal incidence: at 1 its index of refraction is infinite."""
_HERE = translate.Canonical(np.zeros(3), 1.0)
"""The scene's own place and size."""


def write(scene: Scene, path: Path) -> list[str]:
    """Write a scene as Mitsuba's XML; return what it does not say, a sentence each, which stand in its comment too.

    Raises
    ------
    ValueError : the path does not end in .xml: Mitsuba reads no other.
    reference.backend.BackendError : Mitsuba cannot run here.
    """
    mi = backend.import_mitsuba()
    described = describe(scene)
    missing = described["left_out"] + left_out(described)
    files = path.with_suffix(".files")
    shapes = {}
    names = _names([thing.name for thing in scene.objects])
    missing += [f"objects: {thing.name!r}: is called {name!r}" for thing, name in _renamed(scene.objects, names)]
    for number, (thing, said) in enumerate(zip(scene.objects, described["objects"], strict=True)):
        mesh = thing.mesh if said["normals"] is not None else attrs.evolve(thing.mesh, normals=None)
        name = f"{number:02d}.ply"
        write_atomically(files / name, lambda temporary, mesh=mesh: translate.write_ply(temporary, mesh, _HERE))
        shapes[names[number]] = _shape(said, f"{files.name}/{name}")
    lights = {f"light: {number}": _light(mi, light) for number, light in enumerate(described["lights"])}
    if described["sky"] is not None and described["sky"]["type"] == "image":
        texels = panorama.latitude_longitude(scene.sky, scene.camera.position)
        write_atomically(files / "sky.exr", lambda temporary: openexr.write(temporary, texels))
    dictionary = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": -1, "rr_depth": 8},
        "sensor": _sensor(mi, described, reach(scene)),
        **shapes,
        **lights,
        **_sky(mi, described["sky"], f"{files.name}/sky.exr"),
    }
    state = mi.parser.parse_dict(mi.parser.ParserConfig(mi.variant()), dictionary)
    # What stands at the top is known by an id, which the parser writes only where something refers to it.
    text = re.sub(
        r'^    <(\w+) type="(\w+)" name=', r'    <\1 type="\2" id=', mi.parser.write_string(state), flags=re.M
    )
    comment = "\n".join(["", f"{described['name']}, written by Termwise. Not in this file:", *missing, ""])
    comment = f"<!--{comment.replace('--', '- -')}-->\n"
    write_atomically(path, lambda temporary: temporary.write_text(comment + text, "utf-8"))
    return missing


def left_out(described: dict[str, Any]) -> list[str]:
    """What plain Mitsuba cannot say of a scene described."""
    found = [
        f"objects: {thing['name']!r}: gloss = {thing['material']['gloss']!r}: the lobe has the Fresnel reflectance of "
        "a dielectric of the same f0, not Schlick's, and a rational approximation of Smith's masking"
        for thing in described["objects"]
        if thing["material"]["gloss"] > 0.0
    ]
    found += [
        f"lights[{number}]: sun: a directional light without a disc"
        for number, light in enumerate(described["lights"])
        if light["type"] == "sun"
    ]
    if described["sky"] is not None and described["sky"]["type"] == "image":
        found.append("sky: resampled as the camera sees it, and infinitely far")
    return found


def _names(names: list[str]) -> list[str]:
    """Names that Mitsuba takes: it takes no dots, and none may stand twice."""
    found: list[str] = []
    for name in names:
        plain = " ".join(re.sub("[.:]", "_", name).split())
        while plain in (*found, *RESERVED):
            plain += "_"
        found.append(plain)
    return found


def _renamed(objects: tuple[Object, ...], names: list[str]) -> list[tuple[Object, str]]:
    return [(thing, name) for thing, name in zip(objects, names, strict=True) if thing.name != name]


def _sensor(mi: Any, described: dict[str, Any], size: float) -> dict[str, Any]:
    """The camera, by whose clipping planes nothing is cut off."""
    camera = described["camera"]
    position = np.array(camera["position"])
    width, height = described["film"]["resolution"]
    return {
        "type": "perspective",
        "fov": camera["horizontal_fov"],
        "fov_axis": "x",
        "near_clip": 1e-4 * size,
        "far_clip": 1e4 * size,
        "to_world": mi.ScalarTransform4f().look_at(
            origin=position.tolist(), target=(position + camera["forward"]).tolist(), up=camera["up"]
        ),
        "film": {
            "type": "hdrfilm",
            "width": width,
            "height": height,
            "rfilter": {"type": "box"},
            "component_format": "float32",
            "pixel_format": "rgb",
        },
        "sampler": {"type": "independent", "sample_count": 64},
    }


def _shape(said: dict[str, Any], file: str) -> dict[str, Any]:
    described: dict[str, Any] = {
        "type": "ply",
        "filename": file,
        "face_normals": said["normals"] is None,
        "bsdf": {"type": "twosided", "bsdf": _bsdf(said["material"])},
    }
    if any(said["emission"]):
        described["emitter"] = {"type": "area", "radiance": _rgb(said["emission"])}
    return described


def _bsdf(material: dict[str, Any]) -> dict[str, Any]:
    diffuse = {"type": "diffuse", "reflectance": _rgb(material["color"])}
    if material["gloss"] == 0.0:
        return diffuse
    # A conductor without absorption is a dielectric seen from outside: f0 = ((n - 1) / (n + 1))².
    roots = [math.sqrt(min(f0, BRIGHT)) for f0 in material["f0"]]
    lobe = {
        "type": "roughconductor",
        "distribution": "beckmann",
        "alpha": material["roughness"],
        "eta": _rgb([(1.0 + root) / (1.0 - root) for root in roots]),
        "k": _rgb([0.0, 0.0, 0.0]),
    }
    return {"type": "blendbsdf", "weight": material["gloss"], "first": diffuse, "second": lobe}


def _light(mi: Any, light: dict[str, Any]) -> dict[str, Any]:
    if light["type"] == "sphere":
        return {
            "type": "sphere",
            "center": light["center"],
            "radius": light["radius"],
            "bsdf": translate.BLACK_BSDF,
            "emitter": {"type": "area", "radiance": _rgb(light["radiance"])},
        }
    if light["type"] in ("directional", "sun"):
        return {"type": "directional", "direction": light["direction"], "irradiance": _rgb(light["irradiance"])}
    if light["type"] == "spot":
        way = np.array(light["axis"])
        return {
            "type": "spot",
            "intensity": _rgb(light["intensity"]),
            "beam_width": light["beam"],
            "cutoff_angle": light["cutoff"],
            "to_world": mi.ScalarTransform4f().look_at(
                origin=light["position"],
                target=(light["position"] + way).tolist(),
                up=np.eye(3)[np.argmin(np.abs(way))].tolist(),
            ),
        }
    return {"type": "point", "position": light["position"], "intensity": _rgb(light["intensity"])}


def _sky(mi: Any, sky: dict[str, Any] | None, file: str) -> dict[str, Any]:
    if sky is None:
        return {}
    if sky["type"] == "constant":
        return {"sky": {"type": "constant", "radiance": _rgb(sky["radiance"])}}
    # Mitsuba's map has +y at the top and -z in the middle.
    turned = mi.ScalarTransform4f([[0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    return {"sky": {"type": "envmap", "filename": file, "to_world": turned}}


def _rgb(color: Any) -> dict[str, Any]:
    return {"type": "rgb", "value": [float(component) for component in color]}
