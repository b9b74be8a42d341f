"""A scene from GLB: nodes with their transforms, materials, emission, point lights and the first camera.

glTF's y is up and becomes z, exactly: (x, y, z) is at (x, -z, y). A nit is our unit of radiance, a candela that of
intensity. An emitting material of one side is a lamp; its back, which glTF does not show, is black here.
"""

import contextlib
import math
from pathlib import Path
from typing import Any

import attrs
import numpy as np

from termwise.scenes.exchange import gltf_numbers
from termwise.scenes.exchange.imported import LONGEST, MIRROR, Import, Unsaid, coated, look
from termwise.scenes.exchange.mitsuba import SMOOTH
from termwise.scenes.meshes.glb import File, described
from termwise.scenes.model import BLACK, Color, DirectionalLight, Material, PointLight, Scene, SpotLight, largest
from termwise.scenes.textures import Encoding, Texture, Wrap, downwards, read_within

_REPEAT, _CLAMP, _MIRRORED, _NEAREST = 10497, 33071, 33648, 9728
_WRAPS: dict[int, Wrap] = {_REPEAT: "repeat", _CLAMP: "clamp"}
_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
_F0 = 0.04
"""Of a dielectric whose index of refraction is glTF's default, 1.5."""
_KNOWN = {
    "KHR_materials_diffuse_transmission",
    "KHR_materials_emissive_strength",
    "KHR_materials_specular",
    "KHR_materials_ior",
    "KHR_materials_transmission",
    "KHR_materials_volume",
}
_TINY = 1e-4
"""Of a matrix whose columns should be orthogonal and of one length."""


def read(path: Path, *, approximate: bool) -> Scene:
    """Read a scene, see `scenes.load.load`."""
    found = Import(path, approximate)
    with described(path) as file:
        if file.description.get("animations"):
            found.instead("animations", f"{len(file.description['animations'])} of them", "the pose at rest")
        for number, primitive, points, faces in file.primitives():
            with contextlib.suppress(Unsaid):
                _primitive(found, file, number, primitive, points, faces)
        for number in file.scene():
            node = file.item("nodes", number)
            light = node.get("extensions", {}).get("KHR_lights_punctual")
            with contextlib.suppress(Unsaid):
                if light is not None:
                    _light(found, file, number, light["light"])
            with contextlib.suppress(Unsaid):
                if "camera" in node:
                    _camera(found, file, number, node["camera"])
        _size(found, _described_scene(file).get("extras"))
    return found.scene()


def _described_scene(file: File) -> Any:
    scenes = file.description.get("scenes", [])
    return file.item("scenes", file.description.get("scene", 0)) if scenes else {}


def _size(found: Import, extras: Any) -> None:
    """The size of the picture, which `exchange.gltf` writes as an extra, where it is of the camera's shape."""
    size = extras.get("resolution") if isinstance(extras, dict) else None
    if not (isinstance(size, list) and len(size) == 2 and all(isinstance(each, int) and each > 0 for each in size)):
        return
    width, height = found.resolution or size
    # The camera's size is rounded to pixels.
    if found.camera is None or abs(size[0] / size[1] * height / width - 1.0) <= 1.0 / min(width, height):
        found.resolution = size[0], size[1]


def _named(kind: str, item: Any, number: int) -> str:
    return item.get("name") or f"{kind} {number}"


def _primitive(found: Import, file: File, number: int, primitive: Any, points: np.ndarray, faces: np.ndarray) -> None:
    """An object for each primitive of a node's mesh."""
    node = file.item("nodes", number)
    name = _named("node", node, number)
    if "EXT_mesh_gpu_instancing" in node.get("extensions", {}):
        raise found.refuse(name, "EXT_mesh_gpu_instancing")
    attributes = primitive["attributes"]
    if "skin" in node or primitive.get("targets"):
        found.instead(name, "a skin or a morph", "the pose at rest, flat")
    normals = None
    if "NORMAL" in attributes and "skin" not in node and not primitive.get("targets"):
        matrix = file.world(number)[:3, :3]
        normals = file.accessor(attributes["NORMAL"]) @ np.linalg.inv(matrix) @ _UP.T
    tint = np.ones(3)
    if "COLOR_0" in attributes:
        found.instead(name, "COLOR_0, colours at the vertices", "their mean")
        tint = file.accessor(attributes["COLOR_0"])[:, :3].mean(axis=0)
    used, called = {}, name
    if "material" in primitive:
        used = file.item("materials", primitive["material"])
        named = isinstance(used, dict) and "name" in used
        called = f"material {used['name']!r}" if named else name
        gltf_numbers.check(f"{found.path}: {called}", used, gltf_numbers.MATERIAL)
    images = _Images(found, file, primitive, called)
    material, emission = _material(found, used, tint, images)
    material = _transparent(found, used, images, name, material)
    material = _translucent(found, used, name, material)
    uv = None if images.places is None else images.places[faces]
    found.add(name, points @ _UP.T, faces, material, normals=normals, emission=emission, uv=uv)


def _translucent(found: Import, used: Any, name: str, material: Material) -> Material:
    """The material with light that crosses it, of the one colour that it has."""
    given = used.get("extensions", {}).get("KHR_materials_diffuse_transmission", {})
    share = given.get("diffuseTransmissionFactor", 0.0)
    for texture in ("diffuseTransmissionTexture", "diffuseTransmissionColorTexture"):
        if texture in given:
            found.instead(name, texture, "its factor alone")
    if share > 0.0 and (
        isinstance(material.color, Texture)
        or not np.allclose(given.get("diffuseTransmissionColorFactor", (1.0, 1.0, 1.0)), material.color)
    ):
        found.instead(name, "diffuseTransmissionColorFactor", "the colour of the diffuse part")
    return attrs.evolve(material, translucency=share)


class _Images:
    """The images of a material on a primitive, whose corners have one place for all of them.

    Attributes
    ----------
    name : of the material.
    places : (V, 2) of the primitive's points, v upwards; None until an image lies there.
    """

    def __init__(self, found: Import, file: File, primitive: Any, name: str) -> None:
        self._found, self._file, self._primitive, self.name = found, file, primitive, name
        self.places: np.ndarray | None = None

    def read(self, feature: str, holder: Any, *, encoded: bool) -> tuple[np.ndarray, Wrap]:
        """Texels (H, W, 3) and how they go on; the mean (3,) where the model cannot say how they lie; 1 without.

        `encoded`: as sRGB; else they are linear.
        """
        if feature not in holder:
            return np.ones(3), "repeat"
        info = holder[feature]
        texture = self._file.item("textures", info["index"])
        texels = self._texels(feature, texture, "sRGB" if encoded else "linear")
        moved = info.get("extensions", {}).get("KHR_texture_transform", {})
        places = self._file.places(self._primitive, moved.get("texCoord", info.get("texCoord", 0)))
        if places is not None:  # the extension's v goes down, as the file's
            shifted = downwards(places) * moved.get("scale", (1.0, 1.0)) + moved.get("offset", (0.0, 0.0))
            places = downwards(shifted)
        sampler = self._file.item("samplers", texture["sampler"]) if "sampler" in texture else {}
        wraps = {sampler.get(name, _REPEAT) for name in ("wrapS", "wrapT")}
        if places is not None and ((places >= 0.0) & (places <= 1.0)).all():
            # An image that is mirrored beyond its border goes on with the border's own texels.
            wraps = {_CLAMP if wrap == _MIRRORED else wrap for wrap in wraps}
        if moved.get("rotation", 0.0) != 0.0:
            unsaid = "that is turned"
        elif places is None:
            unsaid = "without a TEXCOORD of its number"
        elif self.places is not None and not np.array_equal(places, self.places):
            unsaid = "that lies otherwise than another image of the material"
        elif len(wraps) > 1 or not wraps <= {*_WRAPS}:
            unsaid = "that is mirrored, or goes on otherwise along u than along v"
        elif sampler.get("magFilter") == _NEAREST:
            unsaid = "that is not interpolated"
        else:
            self.places = places
            return texels, _WRAPS[wraps.pop()]
        self._found.instead(self.name, f"{feature} {unsaid}", "its mean")
        return texels.mean(axis=(0, 1)), "repeat"

    def _texels(self, feature: str, texture: Any, encoding: Encoding) -> np.ndarray:
        if "source" not in texture:
            raise self._found.refuse(
                self.name, f"{feature} of {', '.join(texture.get('extensions', {})) or 'no image'}"
            )
        image = self._file.item("images", texture["source"])
        if "bufferView" in image:
            view = self._file.item("bufferViews", image["bufferView"])
            begin = view.get("byteOffset", 0)
            content = self._file.buffer(view["buffer"])[begin : begin + view["byteLength"]]
        else:
            content = self._file.linked(image["uri"])
        try:
            return read_within(content, encoding).astype(np.float64)
        except ValueError as error:
            raise self._found.refuse(self.name, f"{feature}: an image that cannot be read ({error})") from None


_MOSTLY = 0.5
"""Of what goes through a surface that a transparent one stands for; of less an opaque one does."""


def _transparent(found: Import, used: Any, images: _Images, name: str, material: Material) -> Material:
    """Glass in the place of the material, where light goes through it.

    With a volume it is refracted. Without, it goes straight on, as through one face of no index.
    """
    extensions = used.get("extensions", {})
    given = extensions.get("KHR_materials_transmission", {})
    volume = extensions.get("KHR_materials_volume", {})
    surface = used.get("pbrMetallicRoughness", {})
    if given.get("transmissionFactor", 0.0) == 0.0:
        return material
    # Metal lets nothing through.
    metallic = images.read("metallicRoughnessTexture", surface, encoded=False)[0][..., 2].mean()
    share = float(given["transmissionFactor"] * (1.0 - surface.get("metallicFactor", 1.0) * metallic))
    if share == 0.0:
        return material
    if "transmissionTexture" in given:
        found.instead(name, "transmissionTexture", "its factor alone")
    if share < 1.0:
        mostly = share >= _MOSTLY
        found.instead(name, f"transmissionFactor {share:g}", "glass without a diffuse part" if mostly else "no glass")
        if not mostly:
            return material
    if "attenuationColor" in volume or "thicknessTexture" in volume:
        found.instead(name, "a volume that absorbs light", "a clear one")
    roughness = float(np.clip(surface.get("roughnessFactor", 1.0) ** 2, SMOOTH, 1.5))
    ior = extensions.get("KHR_materials_ior", {}).get("ior", 1.5)
    if volume.get("thicknessFactor", 0.0) == 0.0:
        found.instead(name, "glass without a volume", "a face that light goes straight through, and reflects nothing")
        ior = 1.0
    if not 0.1 <= ior <= 10.0:
        raise found.refuse(name, f"glass of ior {ior:g}")
    if "metallicRoughnessTexture" in surface:
        found.instead(name, "metallicRoughnessTexture of glass", "its factor alone")
    if "baseColorTexture" in surface:
        found.instead(name, "baseColorTexture of glass", "its mean")
    color = images.read("baseColorTexture", surface, encoded=True)[0].reshape(-1, 3).mean(axis=0)
    tint = np.clip(color * surface.get("baseColorFactor", (1.0, 1.0, 1.0, 1.0))[:3], 0.0, 1.0)
    specular = extensions.get("KHR_materials_specular", {})
    gloss = specular.get("specularFactor", 1.0) * min(float(np.mean(specular.get("specularColorFactor", 1.0))), 1.0)
    return Material(BLACK, gloss, roughness, transparency=share, ior=ior, tint=tuple(tint.tolist()))


def _colored(values: np.ndarray, wrap: Wrap) -> Color | Texture:
    """A colour, or an image of texels (H, W, 3)."""
    if values.ndim == 3:
        return Texture(values, wrap)
    red, green, blue = values.tolist()
    return red, green, blue


def _material(found: Import, used: Any, tint: np.ndarray, images: _Images) -> tuple[Material, Color | Texture]:
    """Surface and radiance of a material described."""
    extensions, name = used.get("extensions", {}), images.name
    for extension in ("KHR_materials_unlit", "KHR_materials_pbrSpecularGlossiness"):
        if extension in extensions:
            raise found.refuse(name, extension)
    for extension in extensions:
        if extension not in _KNOWN:
            found.instead(name, extension, "the material without it")
    surface = used.get("pbrMetallicRoughness", {})
    texels, wrap = images.read("baseColorTexture", surface, encoded=True)
    values = texels * surface.get("baseColorFactor", (1.0, 1.0, 1.0, 1.0))[:3] * tint
    color = _colored(values, wrap)
    for texture in ("normalTexture", "occlusionTexture"):
        if texture in used:
            found.instead(name, texture, "the material without it")
    if used.get("alphaMode", "OPAQUE") != "OPAQUE":
        found.instead(name, f"alphaMode {used['alphaMode']}", "an opaque surface")
    emission = _emission(used, images)
    shines = any(largest(emission))
    if shines and used.get("doubleSided", False):
        found.instead(name, "a lamp of two sides", "one that shines from the front")
    if not shines and not used.get("doubleSided", False):
        found.instead(name, "one side, for doubleSided is not true", "a surface of two sides")
    specular = extensions.get("KHR_materials_specular", {})
    index = extensions.get("KHR_materials_ior", {}).get("ior", 1.5)
    f0 = specular.get("specularFactor", 1.0) * (_F0 if index == 1.5 else ((index - 1.0) / (index + 1.0)) ** 2)
    if "specularTexture" in specular or "specularColorTexture" in specular:
        found.instead(name, "a texture of KHR_materials_specular", "the material without it")
    if "specularColorFactor" in specular:
        found.instead(name, "specularColorFactor", "its mean")
        f0 *= float(np.mean(specular["specularColorFactor"]))
    metallic, roughness = surface.get("metallicFactor", 1.0), surface.get("roughnessFactor", 1.0)
    if metallic == 0.0 and specular.get("specularFactor", 1.0) == 0.0:
        return Material(color, 0.0), emission
    if not values.any() and shines:
        # Black but for a dielectric's reflection, which is what a lamp loses in `Import.add`.
        return coated((0.0, 0.0, 0.0), metallic=0.0, f0=f0, roughness=roughness**2), emission
    texels, wrap = images.read("metallicRoughnessTexture", surface, encoded=False)
    if metallic != 0.0 and np.ptp(texels[..., 2]) > 0.0:
        found.instead(name, "metallicRoughnessTexture, whose metallic part is an image", "its mean")
    if metallic != 0.0 and values.ndim == 3:
        found.instead(name, "baseColorTexture of a metal, whose reflectance is an image", "its mean")
    metallic *= float(np.mean(texels[..., 2]))
    rough = roughness * texels[..., 1]
    said = f"{rough:g}" if rough.ndim == 0 else "of an image"
    found.instead(
        name,
        f"GGX's lobe, metallic {metallic:g}, roughness {said}, F0 {f0:g}",
        "Beckmann's of the same alpha, equal at normal incidence",
    )
    mean = values.reshape(-1, 3).mean(axis=0).tolist()
    lobe = coated(mean, metallic=metallic, f0=min(f0, 1.0), roughness=float(np.mean(rough)) ** 2)
    if rough.ndim:
        lobe = attrs.evolve(lobe, roughness=Texture(np.clip(rough**2, MIRROR, 1.5), wrap))
    return attrs.evolve(lobe, color=color), emission


def _emission(used: Any, images: _Images) -> Color | Texture:
    strength = used.get("extensions", {}).get("KHR_materials_emissive_strength", {}).get("emissiveStrength", 1.0)
    radiance = np.array(used.get("emissiveFactor", (0.0, 0.0, 0.0)), float) * strength
    if not radiance.any():
        return BLACK
    texels, wrap = images.read("emissiveTexture", used, encoded=True)
    values = radiance * texels
    return _colored(values, wrap) if values.any() else BLACK


def _light(found: Import, file: File, number: int, light: int) -> None:
    """A light by the place of its node, which shines along its -z."""
    given = file.description["extensions"]["KHR_lights_punctual"]["lights"][light]
    name = _named("light", file.item("nodes", number), number)
    gltf_numbers.check(f"{found.path}: {name}", given, gltf_numbers.LIGHT)
    if "range" in given:
        found.instead(name, f"range {given['range']}, beyond which it ends", "a light without an end")
    color = tuple((np.array(given.get("color", (1.0, 1.0, 1.0)), float) * given.get("intensity", 1.0)).tolist())
    world = _UP @ file.world(number)[:3]
    position, way = tuple(world[:, 3].tolist()), -world[:, 2]
    if given["type"] == "directional":
        found.lights.append(DirectionalLight(tuple(way.tolist()), color))
    elif given["type"] == "spot":
        found.instead(name, "a spot light that falls with the square of a cosine", "one that falls with the angle")
        cone = given.get("spot", {})
        outer = math.degrees(cone.get("outerConeAngle", math.pi / 4.0))
        inner = math.degrees(cone.get("innerConeAngle", 0.0))
        found.lights.append(SpotLight(position, tuple((world[:, 3] + way).tolist()), color, outer, inner))
    elif given["type"] == "point":
        found.lights.append(PointLight(position, color))
    else:
        raise found.refuse(name, f"a light of type {given['type']}")


def _camera(found: Import, file: File, number: int, camera: int) -> None:
    """The first camera; further ones are named."""
    given = file.item("cameras", camera)
    name = _named("camera", file.item("nodes", number), number)
    gltf_numbers.check(f"{found.path}: {name}", given, gltf_numbers.CAMERA)
    if found.camera is not None:
        found.assume(f"the first camera is meant, not {name}")
        return
    if given["type"] != "perspective":
        raise found.refuse(name, f"a camera of type {given['type']}")
    lens = given["perspective"]
    world = file.world(number)
    columns = _UP @ world[:3, :3]
    length = np.linalg.norm(columns, axis=0)
    turned = columns / length
    if np.abs(turned.T @ turned - np.eye(3)).max() > _TINY or np.linalg.det(turned) < 0.0:
        raise found.refuse(name, "a matrix that skews or mirrors the picture")
    aspect = lens.get("aspectRatio", 4.0 / 3.0)
    if "aspectRatio" not in lens:
        found.assume("a picture of 4 : 3, for the camera has no aspectRatio")
    fov = 2.0 * math.degrees(math.atan(math.tan(lens["yfov"] / 2.0) * aspect))
    found.camera = look(_UP @ world[:3, 3], -turned[:, 2], turned[:, 1], fov)
    found.resolution = (
        (LONGEST, max(round(LONGEST / aspect), 1)) if aspect >= 1 else (max(round(LONGEST * aspect), 1), LONGEST)
    )
    found.clipped(found.camera, lens["znear"], lens.get("zfar", math.inf))
