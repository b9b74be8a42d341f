"""What `{scene}` is: a function a format, which writes what is asked into a folder and gives the file to name.

`neutral` holds all of it. `mitsuba` is XML that any reader of Mitsuba's takes: plain values and no plugin of ours,
meshes as PLY beside it; samples, seed and depth stand in it too. It is written here, and not by Mitsuba, because lamps
that reflect are no scene of our model, and because an engine may be the only renderer that is installed. `gltf` and
`pbrt` are those of `scenes.exchange`; `termwise` is a scene file of ours.
"""

import importlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import attrs
import numpy as np

from termwise.reports.engines.asked import Asked
from termwise.scenes.exchange import panorama
from termwise.scenes.images import openexr
from termwise.scenes.save import save

_REACH = 1e-4, 1e4
"""Clipping planes, of the distance that the camera has to what is farthest away."""


def write(kind: str, asked: Asked, folder: Path, *, depth: int | None, spp: int, seed: int) -> Path:
    """Write what is asked in a format; `depth` None: light scatters as often as it likes."""
    folder.mkdir()
    return _WRITERS[kind](asked, folder, depth, spp, seed)


def _neutral(asked: Asked, folder: Path, depth: int | None, spp: int, seed: int) -> Path:
    sky = asked.described["sky"]
    if sky is not None and sky["type"] == "image":
        openexr.write(folder / sky["file"], _texture(asked))
    path = folder / "scene.json"
    path.write_text(json.dumps(asked.described, allow_nan=False), "utf-8")
    return path


def _termwise(asked: Asked, folder: Path, depth: int | None, spp: int, seed: int) -> Path:
    """Light that scatters once is direct light of the first hit; our renderer knows no other depth."""
    path = folder / "scene.toml"
    save(asked.scene if depth is None else attrs.evolve(asked.scene, scope="first-hit"), path)
    return path


def _exchanged(kind: str) -> Callable[[Asked, Path, int | None, int, int], Path]:
    def written(asked: Asked, folder: Path, depth: int | None, spp: int, seed: int) -> Path:
        module = importlib.import_module(f"termwise.scenes.exchange.{kind}")
        path = folder / f"scene{module.SUFFIX}"
        module.write(asked.scene, path)
        return path

    return written


def _texture(asked: Asked) -> np.ndarray:
    assert asked.scene.sky.texture is not None
    return asked.scene.sky.texture


def _mitsuba(asked: Asked, folder: Path, depth: int | None, spp: int, seed: int) -> Path:
    """A path is one edge longer than light scatters often: what is seen to shine has max_depth 1."""
    described = asked.described
    root = ElementTree.Element("scene", version="3.0.0")
    integrator = _plugin(root, "integrator", "path")
    _value(integrator, "integer", "max_depth", -1 if depth is None else depth + 1)
    _sensor(root, described, spp, seed)
    for number, thing in enumerate(described["objects"]):
        _shape(root, thing, folder, f"object{number}.ply")
    for light in described["lights"]:
        _light(root, light)
    sky = described["sky"]
    if sky is not None and sky["type"] == "constant":
        _value(_plugin(root, "emitter", "constant"), "rgb", "radiance", _numbers(sky["radiance"]))
    elif sky is not None:
        texels = panorama.latitude_longitude(asked.scene.sky, asked.scene.camera.position)
        openexr.write(folder / "sky.exr", texels)
        emitter = _plugin(root, "emitter", "envmap")
        _value(emitter, "string", "filename", "sky.exr")
        # Mitsuba's map has +y at the top and -z in the middle.
        _matrix(emitter, [[0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    path = folder / "scene.xml"
    ElementTree.indent(root)
    ElementTree.ElementTree(root).write(path, "utf-8")
    return path


def _sensor(root: ElementTree.Element, described: dict[str, Any], spp: int, seed: int) -> None:
    camera, (width, height) = described["camera"], described["film"]["resolution"]
    position = np.array(camera["position"])
    corners = np.concatenate([np.array(thing["vertices"]) for thing in described["objects"]] or [np.zeros((0, 3))])
    far = float(np.linalg.norm(corners - position, axis=1).max(initial=0.0)) or 1.0
    sensor = _plugin(root, "sensor", "perspective")
    _value(sensor, "float", "fov", camera["horizontal_fov"])
    _value(sensor, "string", "fov_axis", "x")
    _value(sensor, "float", "near_clip", _REACH[0] * far)
    _value(sensor, "float", "far_clip", _REACH[1] * far)
    place = ElementTree.SubElement(sensor, "transform", name="to_world")
    target = position + camera["forward"]
    look = {"origin": _numbers(position), "target": _numbers(target), "up": _numbers(camera["up"])}
    ElementTree.SubElement(place, "lookat", look)
    film = _plugin(sensor, "film", "hdrfilm")
    _value(film, "integer", "width", width)
    _value(film, "integer", "height", height)
    _value(film, "string", "pixel_format", "rgb")
    _value(film, "string", "component_format", "float32")
    _plugin(film, "rfilter", "box")
    sampler = _plugin(sensor, "sampler", "independent")
    _value(sampler, "integer", "sample_count", spp)
    _value(sampler, "integer", "seed", seed)


def _light(root: ElementTree.Element, light: dict[str, Any]) -> None:
    if light["type"] == "sphere":
        ball = _plugin(root, "shape", "sphere")
        _value(ball, "point", "center", _numbers(light["center"]))
        _value(ball, "float", "radius", light["radius"])
        _value(_plugin(ball, "bsdf", "diffuse"), "rgb", "reflectance", "0, 0, 0")
        _value(_plugin(ball, "emitter", "area"), "rgb", "radiance", _numbers(light["radiance"]))
        return
    emitter = _plugin(root, "emitter", light["type"])
    if light["type"] == "directional":
        _value(emitter, "vector", "direction", _numbers(light["direction"]))
        _value(emitter, "rgb", "irradiance", _numbers(light["irradiance"]))
        return
    _value(emitter, "rgb", "intensity", _numbers(light["intensity"]))
    if light["type"] == "point":
        _value(emitter, "point", "position", _numbers(light["position"]))
        return
    axis = np.array(light["axis"])
    target = np.array(light["position"]) + axis
    up = np.eye(3)[np.argmin(np.abs(axis))]
    place = ElementTree.SubElement(emitter, "transform", name="to_world")
    look = {"origin": _numbers(light["position"]), "target": _numbers(target), "up": _numbers(up)}
    ElementTree.SubElement(place, "lookat", look)
    _value(emitter, "float", "beam_width", light["beam"])
    _value(emitter, "float", "cutoff_angle", light["cutoff"])


def _shape(root: ElementTree.Element, thing: dict[str, Any], folder: Path, name: str) -> None:
    _ply(folder / name, thing)
    shape = _plugin(root, "shape", "ply")
    _value(shape, "string", "filename", name)
    _value(shape, "boolean", "face_normals", "true" if thing["normals"] is None else "false")
    bsdf = _plugin(_plugin(shape, "bsdf", "twosided"), "bsdf", "diffuse")
    _value(bsdf, "rgb", "reflectance", _numbers(thing["material"]["color"]))
    if any(thing["emission"]):
        _value(_plugin(shape, "emitter", "area"), "rgb", "radiance", _numbers(thing["emission"]))


def _ply(path: Path, thing: dict[str, Any]) -> None:
    """Binary PLY, little-endian float32."""
    columns = [np.array(thing["vertices"], np.float32)]
    names = ["x", "y", "z"]
    if thing["normals"] is not None:
        columns.append(np.array(thing["normals"], np.float32))
        names += ["nx", "ny", "nz"]
    faces = np.empty(len(thing["faces"]), np.dtype([("count", "u1"), ("indices", "<i4", 3)]))
    faces["count"], faces["indices"] = 3, thing["faces"]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(columns[0])}"]
    header += [f"property float {name}" for name in names]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header", ""]
    path.write_bytes("\n".join(header).encode() + np.hstack(columns).astype("<f4").tobytes() + faces.tobytes())


def _plugin(parent: ElementTree.Element, tag: str, kind: str) -> ElementTree.Element:
    return ElementTree.SubElement(parent, tag, type=kind)


def _value(parent: ElementTree.Element, tag: str, name: str, value: object) -> None:
    ElementTree.SubElement(parent, tag, name=name, value=str(value))


def _matrix(parent: ElementTree.Element, rows: list[list[float]]) -> None:
    place = ElementTree.SubElement(parent, "transform", name="to_world")
    ElementTree.SubElement(place, "matrix", value=" ".join(f"{x:g}" for row in rows for x in row))


def _numbers(values: Any) -> str:
    return ", ".join(repr(float(value)) for value in values)


_WRITERS: dict[str, Callable[[Asked, Path, int | None, int, int], Path]] = {
    "neutral": _neutral,
    "mitsuba": _mitsuba,
    "termwise": _termwise,
    **{kind: _exchanged(kind) for kind in ("gltf", "pbrt")},
}
