"""GLB, that is glTF 2.0 in one file, with its extensions for lights, emission above 1, translucency, glass, no gloss.

A unit of radiance is a nit: emission is `emissiveFactor * emissiveStrength`, a point's intensity is in candela. A
surface without gloss is `metallicFactor` 0 under `specularFactor` 0, which is Lambert's. glTF's y is up: the scene's z
is turned there by the matrix of the root node, exactly, so that every node below has the scene's own coordinates.
"""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from termwise.scenes.exchange import spheres
from termwise.scenes.exchange.neutral import describe, reach, refuse_images
from termwise.scenes.model import Scene
from termwise.scenes.store import write_atomically

SUFFIX = ".glb"
UPRIGHT = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
"""Columns of the matrix that takes (x, y, z) to (x, z, -y)."""
NEAR = 1e-4
"""Of the way to the farthest vertex: a plane that cuts nothing off, and that glTF wants."""
_FLOAT, _UNSIGNED = 5126, 5125


def write(scene: Scene, path: Path) -> list[str]:
    """Write a scene as GLB; return what it does not say, a sentence each, as its `asset.extras.left_out`."""
    refuse_images(scene, "GLB")
    given = describe(scene)
    described, of_triangles = spheres.meshed(given)
    missing = given["left_out"] + of_triangles + left_out(given)
    content = _Content()
    objects = [_object(thing, content) for thing in described["objects"]]
    lights = [_light(number, light) for number, light in enumerate(described["lights"])]
    camera = described["camera"]
    eye = {"name": "camera", "camera": 0, "matrix": _frame(camera)}
    nodes = [{"name": described["name"], "matrix": UPRIGHT, "children": []}, *objects, *lights, eye]
    # Objects keep their names, which are distinct: by them a scene is told what it is.
    taken = {thing["name"] for thing in objects}
    for node in (nodes[0], *lights, eye):
        node["name"] = _free(node["name"], taken)
    nodes[0]["children"] = list(range(1, len(nodes)))
    used = {"KHR_lights_punctual": bool(lights)}
    extensions = (each for material in content.materials for each in material["extensions"])
    used |= dict.fromkeys(extensions, True)
    width, height = described["film"]["resolution"]
    tangent = math.tan(math.radians(camera["horizontal_fov"]) / 2.0)
    found: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "Termwise", "extras": {"left_out": missing}},
        "scene": 0,
        "scenes": [{"name": described["name"], "nodes": [0], "extras": {"resolution": [width, height]}}],
        "nodes": nodes,
        "cameras": [
            {
                "name": "camera",
                "type": "perspective",
                "perspective": {
                    "yfov": 2.0 * math.atan(tangent * height / width),
                    "aspectRatio": width / height,
                    "znear": NEAR * reach(scene),
                },
            }
        ],
        **content.lists(),
    }
    if any(used.values()):
        found["extensionsUsed"] = sorted(name for name, there in used.items() if there)
    if lights:
        kinds = [_kind(light) | {"name": node["name"]} for node, light in zip(lights, described["lights"], strict=True)]
        found["extensions"] = {"KHR_lights_punctual": {"lights": kinds}}
    write_atomically(path, lambda temporary: temporary.write_bytes(_glb(found, bytes(content.data))))
    return missing


def _free(name: str, taken: set[str]) -> str:
    """A name that is not taken, which it then is."""
    free, number = name, 1
    while free in taken:
        number += 1
        free = f"{name} {number}"
    taken.add(free)
    return free


def left_out(described: dict[str, Any]) -> list[str]:
    """What GLB cannot say of a scene described."""
    found = []
    for thing in described["objects"]:
        material = thing["material"]
        if "fresnel" in material:
            found.append(
                f"objects: {thing['name']!r}: fresnel = 'dielectric': glTF's lobes are GGX's of the same alpha with "
                "Schlick's reflectance, and the diffuse part has what they leave of one base colour"
            )
            if material["ior"] < 1.0:
                found.append(f"objects: {thing['name']!r}: ior = {material['ior']!r}: glTF's is 1 at least: it is 1")
        elif material["gloss"] > 0.0:
            found.append(
                f"objects: {thing['name']!r}: gloss = {material['gloss']!r}: one base colour for both lobes, and the "
                "lobe is GGX's of the same alpha, not Beckmann's"
            )
        if any(thing["emission"]):
            found.append(
                f"objects: {thing['name']!r}: emission: a one-sided material, whose back glTF does not show, not black"
            )
    for number, light in enumerate(described["lights"]):
        if light["type"] == "spot":
            found.append(f"lights[{number}]: spot: glTF's falls as the square of the cosine's way from cutoff to beam")
        if light["type"] == "sun":
            found.append(f"lights[{number}]: sun: a directional light without a disc")
    if described["sky"] is not None:
        found.append(f"sky: {described['sky']['type']}: glTF has none")
    found.append("film: glTF has no pixel filter: a box is meant")
    return found


class _Content:
    """The binary chunk as it grows, and the lists of the description that refer to it."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[Any] = []
        self.accessors: list[Any] = []
        self.meshes: list[Any] = []
        self.materials: list[Any] = []

    def add(self, values: np.ndarray, *, bounds: bool = False) -> int:
        """Store float32 triples, or uint32 indices; the number of their accessor."""
        indices = values.dtype == np.uint32
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": values.nbytes}
        self.views.append(view | {"target": 34963 if indices else 34962})
        self.data += values.tobytes()
        accessor: dict[str, Any] = {"bufferView": len(self.views) - 1, "count": len(values)}
        accessor |= {"componentType": _UNSIGNED if indices else _FLOAT, "type": "SCALAR" if indices else "VEC3"}
        if bounds:
            accessor |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
        self.accessors.append(accessor)
        return len(self.accessors) - 1

    def lists(self) -> dict[str, Any]:
        """The lists, those that are empty left out, as glTF wants it."""
        lists = {"meshes": self.meshes, "materials": self.materials}
        lists |= {"accessors": self.accessors, "bufferViews": self.views}
        if self.data:
            lists["buffers"] = [{"byteLength": len(self.data)}]
        return {name: values for name, values in lists.items() if values}


def _object(thing: dict[str, Any], content: _Content) -> dict[str, Any]:
    """A node with a mesh and a material of its own."""
    attributes = {"POSITION": content.add(np.array(thing["vertices"], "<f4"), bounds=True)}
    if thing["normals"] is not None:
        attributes["NORMAL"] = content.add(np.array(thing["normals"], "<f4"))
    indices = content.add(np.array(thing["faces"], "<u4").ravel())
    content.materials.append(_material(thing))
    primitive = {"attributes": attributes, "indices": indices, "material": len(content.materials) - 1}
    content.meshes.append({"name": thing["name"], "primitives": [primitive]})
    return {"name": thing["name"], "mesh": len(content.meshes) - 1}


def _material(thing: dict[str, Any]) -> dict[str, Any]:
    """Metallic-roughness: `(1 - m) base / pi + m GGX(base)`, the base such that at normal incidence the sum is ours."""
    material, gloss = thing["material"], thing["material"]["gloss"]
    base = [(1.0 - gloss) * color + gloss * f0 for color, f0 in zip(material["color"], material["f0"], strict=True)]
    surface = {
        "baseColorFactor": [*base, 1.0],
        "metallicFactor": gloss,
        "roughnessFactor": min(math.sqrt(material["roughness"]), 1.0) if gloss else 1.0,
    }
    extensions: dict[str, Any] = {"KHR_materials_specular": {"specularFactor": 0.0}}
    if "fresnel" in material:
        # With a volume what goes through is refracted; its colour is the base's.
        surface = {
            "baseColorFactor": [*material.get("tint", material["color"]), 1.0],
            "metallicFactor": 0.0,
            "roughnessFactor": min(math.sqrt(material["roughness"]), 1.0),
        }
        extensions = {
            "KHR_materials_ior": {"ior": max(material["ior"], 1.0)},
            "KHR_materials_specular": {"specularFactor": gloss},
        }
        if "transparency" in material:
            extensions["KHR_materials_transmission"] = {"transmissionFactor": material["transparency"]}
            extensions["KHR_materials_volume"] = {"thicknessFactor": 1.0}
    found: dict[str, Any] = {
        "name": thing["name"],
        "pbrMetallicRoughness": surface,
        "doubleSided": not any(thing["emission"]),
        "extensions": extensions,
    }
    if "translucency" in material:
        extensions["KHR_materials_diffuse_transmission"] = {
            "diffuseTransmissionFactor": material["translucency"],
            "diffuseTransmissionColorFactor": material["color"],
        }
    if any(thing["emission"]):
        scaled = _scaled(thing["emission"], "emissiveFactor", "emissiveStrength")
        found["emissiveFactor"] = scaled["emissiveFactor"]
        if scaled["emissiveStrength"] != 1.0:
            strength = {"emissiveStrength": scaled["emissiveStrength"]}
            extensions["KHR_materials_emissive_strength"] = strength
    return found


def _scaled(value: list[float], color: str, factor: str) -> dict[str, Any]:
    """A colour in [0, 1] and the factor that it is times: 1 where it is not needed."""
    peak = max(1.0, *value)
    return {color: [each / peak for each in value], factor: peak}


def _light(number: int, light: dict[str, Any]) -> dict[str, Any]:
    """The node of a light, which shines along its -z."""
    node = {"name": f"light {number}", "extensions": {"KHR_lights_punctual": {"light": number}}}
    position = light.get("position", [0.0, 0.0, 0.0])
    if light["type"] == "point":
        return node | {"translation": position}
    way = np.array(light["axis"] if light["type"] == "spot" else light["direction"])
    right = np.cross(way, np.eye(3)[np.argmin(np.abs(way))])
    right /= np.linalg.norm(right)
    frame = {
        "right": right.tolist(),
        "up": np.cross(right, way).tolist(),
        "forward": way.tolist(),
        "position": position,
    }
    return node | {"matrix": _frame(frame)}


def _kind(light: dict[str, Any]) -> dict[str, Any]:
    """What shines: candela of a point, lux of what is far."""
    if light["type"] in ("directional", "sun"):
        return {"type": "directional", **_scaled(light["irradiance"], "color", "intensity")}
    found = {"type": light["type"], **_scaled(light["intensity"], "color", "intensity")}
    if light["type"] == "spot":
        outer = math.radians(light["cutoff"])
        inner = min(math.radians(light["beam"]), np.nextafter(outer, 0.0).item())  # glTF wants it to be less
        found["spot"] = {"innerConeAngle": inner, "outerConeAngle": outer}
    return found


def _frame(camera: dict[str, Any]) -> list[float]:
    """Columns of a camera's matrix, or a light's: it looks along its -z, y up."""
    back = [-component for component in camera["forward"]]
    return [*camera["right"], 0.0, *camera["up"], 0.0, *back, 0.0, *camera["position"], 1.0]


def _glb(described: dict[str, Any], data: bytes) -> bytes:
    """The two chunks, each filled up to four bytes."""
    text = json.dumps(described, allow_nan=False, separators=(",", ":")).encode()
    chunks = [(b"JSON", text + b" " * (-len(text) % 4)), (b"BIN\0", data + b"\0" * (-len(data) % 4))]
    body = b"".join(
        len(chunk).to_bytes(4, "little") + kind + chunk for kind, chunk in chunks if chunk or kind == b"JSON"
    )
    return b"glTF" + (2).to_bytes(4, "little") + (12 + len(body)).to_bytes(4, "little") + body
