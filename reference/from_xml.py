"""A scene from Mitsuba's XML: meshes as Mitsuba loads them, diffuse surfaces, area and point lights, skies, a camera.

Mitsuba parses the file and makes its objects, so that includes, parameters, transforms, spectra, normals and the texels
of images mean what they mean there; nothing is rendered. Integrator and sampler are settings of a renderer and are not
read.
A lamp shines on the side of its shading normals, which mirroring turns with it.
"""

import contextlib
import gc
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import attrs
import numpy as np

from termwise.reference import backend
from termwise.scenes.exchange.imported import MIRROR, Import, Unsaid, coated, look
from termwise.scenes.exchange.mitsuba import SMOOTH
from termwise.scenes.model import (
    BLACK,
    BLACK_SURFACE,
    Color,
    DirectionalLight,
    Material,
    PointLight,
    Scene,
    Sky,
    SphereLight,
    SpotLight,
    largest,
    least,
)
from termwise.scenes.strict import FileError
from termwise.scenes.textures import Texture, Wrap, downwards, in_color

_SPHERE, _DISK = 4, 128
"""Subdivisions of an icosphere, and corners of a polygon, that stand for round shapes."""
_MAP = 512
"""Rows of the panorama that an environment map is resampled to."""
_GRID = 32
"""Texels a side, over the unit square of u and v, of which a texture's mean is taken."""
_TINY = 1e-4
"""Of a camera's matrix, whose columns should be orthonormal."""
_WHOLE = ("path", "volpath", "volpathmis", "ptracer", "prb", "prb_basic", "prb_projective", "prbvolpath")
"""Integrators of all light transport, where nothing limits them."""
_MESHES = ("obj", "ply", "serialized", "cube")
_COATED = ("plastic", "roughplastic", "pplastic")
_GLASS = ("dielectric", "roughdielectric")
_CONDUCTORS = ("conductor", "roughconductor")
_OF_ONE_COLOR = ("d65", "srgb", "uniform", "regular", "irregular")
"""Plugins of spectra, which are textures to Mitsuba."""
_WRAPS: dict[str, Wrap] = {"repeat": "repeat", "clamp": "clamp"}
_LUMINANCE = np.array([0.212671, 0.715160, 0.072169])
"""Of red, green and blue, where Mitsuba takes a number of an image of colours."""
_ON_RECTANGLE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
"""Where in an image the corners of a rectangle lie, as Mitsuba has it: v goes down."""


@attrs.frozen
class _Node:
    """A plugin of the file with its properties, and the nodes that it holds."""

    plugin: str
    kind: str
    name: str
    properties: dict[str, Any]
    children: tuple[tuple[str, "_Node"], ...]

    def of(self, kind: str) -> Iterator["_Node"]:
        """Children of a kind, by Mitsuba's name of it."""
        return (child for _, child in self.children if child.kind == kind)

    def texture(self, feature: str) -> "_Node | None":
        """The texture that a feature has, unless it is of one colour."""
        textures = (child for name, child in self.children if name == feature and child.kind == "Texture")
        return next((child for child in textures if child.plugin not in _OF_ONE_COLOR), None)

    def textured(self, feature: str) -> str | None:
        """The plugin of that texture."""
        texture = self.texture(feature)
        return None if texture is None else texture.plugin


@attrs.define
class _Images:
    """The bitmaps of a shape, all of which lie on it in one way.

    Attributes
    ----------
    found : where it is noted what stands for those that do not.
    own : (V, 2) where in an image Mitsuba has the vertices, v downwards; None where it has no such places.
    places : (V, 2) of the vertices, v upwards; None until an image lies there.
    """

    found: Import
    own: np.ndarray | None
    places: np.ndarray | None = None

    def number(self, name: str, node: _Node, feature: str, parameters: Any, prefix: str) -> float | Texture:
        """As `color`, of one number: of colours Mitsuba takes the luminance."""
        read = self._read(name, node, feature, parameters, prefix)
        if read is None:
            return _color(parameters[f"{prefix}{feature}.value"])[0]
        values, wrap = read
        values = values[..., 0] if np.ptp(values, axis=-1).max() == 0.0 else values @ _LUMINANCE
        return Texture(values, wrap) if values.ndim else float(values)

    def color(self, name: str, node: _Node, feature: str, parameters: Any, prefix: str) -> Color | Texture:
        """Colour or image that a feature of a node has; the mean of an image that the model cannot say how it lies.

        Parameters
        ----------
        name : of what has it, in messages.
        node : whose feature it is, of one colour or a bitmap.
        parameters : as Mitsuba traverses what it made, where `prefix` leads to those of the node.
        """
        read = self._read(name, node, feature, parameters, prefix)
        if read is None:
            return _color(parameters[f"{prefix}{feature}.value"])
        values, wrap = read
        return Texture(in_color(values), wrap) if values.ndim == 3 else _color(values)

    def plain(self, name: str, node: _Node, feature: str, parameters: Any, prefix: str) -> Color:
        """As `color`, where the model has no image: the mean of one."""
        if (texture := node.texture(feature)) is None:
            return _color(parameters[f"{prefix}{feature}.value"])
        texels = self._texels(name, node, texture, feature, parameters, prefix)
        self.found.instead(name, f"bitmap, a texture of {feature}", "its mean")
        return _color(texels.mean(axis=(0, 1)))

    def _read(
        self, name: str, node: _Node, feature: str, parameters: Any, prefix: str
    ) -> tuple[np.ndarray, Wrap] | None:
        """Texels (H, W, C) and how they go on, or their mean (C,); None of what has one colour."""
        texture = node.texture(feature)
        if texture is None:
            return None
        texels = self._texels(name, node, texture, feature, parameters, prefix)
        wrap = texture.properties.get("wrap_mode", "repeat")
        places = None
        if self.own is not None:
            to_uv = np.array(parameters[f"{prefix}{feature}.to_uv"].matrix, np.float64).reshape(3, 3)
            places = downwards(self.own @ to_uv[:2, :2].T + to_uv[:2, 2])
            if wrap == "mirror" and ((places >= 0.0) & (places <= 1.0)).all():
                wrap = "clamp"  # it goes on with the border's own texels
        if places is None:
            unsaid = "on a shape without places in it"
        elif self.places is not None and not np.array_equal(places, self.places):
            unsaid = "that lies otherwise than another of the shape"
        elif wrap not in _WRAPS:
            unsaid = "that is mirrored"
        elif texture.properties.get("filter_type", "bilinear") != "bilinear":
            unsaid = "that is not interpolated"
        else:
            self.places = places
            return texels, _WRAPS[wrap]
        self.found.instead(name, f"bitmap, a texture of {feature}, {unsaid}", "its mean")
        return texels.mean(axis=(0, 1)), "repeat"

    def _texels(self, name: str, node: _Node, texture: _Node, feature: str, parameters: Any, prefix: str) -> np.ndarray:
        """Of a bitmap, (H, W, C) float64: what Mitsuba interpolates, linear."""
        data = f"{prefix}{feature}.data"
        if data not in parameters:  # of no bitmap, or of one that is another feature's too
            raise self.found.refuse(name, f"{texture.plugin} for {feature} of {node.plugin}")
        return np.array(parameters[data], np.float64)


def read(path: Path, *, approximate: bool) -> Scene:
    """Read a scene, see `scenes.load.load`.

    Raises
    ------
    reference.backend.BackendError : Mitsuba cannot run here.
    """
    with backend.rendering() as mi:
        return _read(mi, Import(path, approximate))


def _read(mi: Any, found: Import) -> Scene:
    path = found.path
    root, made = _parsed(mi, path)
    try:
        _check(found, root)
        shapes = made.shapes()
        described = [*root.of("Shape")]
        if len(shapes) != len(described):
            raise FileError(f"{path}: holds {len(described)} shapes, of which Mitsuba makes {len(shapes)}")
        for node, shape in zip(described, shapes, strict=True):
            with contextlib.suppress(Unsaid):
                _shape(mi, found, node, shape)
        # Lamps are their shapes'; the others stand in the file's order.
        lights = [each for each in made.emitters() if not mi.has_flag(each.flags(), mi.EmitterFlags.Surface)]
        nodes = [node for node in root.of("Emitter") if node.plugin != "area"]
        for node, light in zip(nodes, lights, strict=True):
            with contextlib.suppress(Unsaid):
                _emitter(mi, found, node, light)
        sensors = [*root.of("Sensor")]
        if sensors:
            with contextlib.suppress(Unsaid):
                _sensor(mi, found, sensors[0], made.sensors()[0])
        for other in sensors[1:]:
            found.assume(f"the first sensor is meant, not {other.name}")
        _transport(found, root)
    finally:
        del made, root
        gc.collect()  # every material that exists would be compiled into every kernel
    return found.scene()


def _parsed(mi: Any, path: Path) -> tuple[_Node, Any]:
    """The tree of plugins, and the scene that Mitsuba makes of it."""
    level, known = mi.log_level(), mi.file_resolver()
    here = mi.FileResolver(known)
    here.prepend(str(path.parent))
    mi.set_log_level(mi.LogLevel.Error)
    mi.set_file_resolver(here)
    config = mi.parser.ParserConfig(mi.variant())
    config.merge_meshes = config.merge_equivalent = False
    try:
        state = mi.parser.parse_file(config, str(path))
        mi.parser.transform_all(config, state)
        for node in state.nodes:
            if node.props.plugin_name() == "bitmap" and node.props.get("format", "auto") == "auto":
                node.props["format"] = "variant"  # else whole numbers stay so, to be decoded late
        tree = _node(mi, state, 0)
        _refuse_groups(path, tree)
        made = mi.parser.instantiate(config, state)
    except RuntimeError as error:
        said = [line.strip() for line in str(error).splitlines() if line.strip()]
        raise FileError(f"{path}: Mitsuba does not load it: {' '.join(said)[:400]}") from None
    finally:
        mi.set_log_level(level)
        mi.set_file_resolver(known)
    if not isinstance(made, mi.Scene):
        raise FileError(f"{path}: is no scene: allowed is a file whose root is <scene>")
    return tree, made


def _node(mi: Any, state: Any, number: int) -> _Node:
    node = state.nodes[number]
    properties, children = {}, []
    for key in node.props.keys():  # noqa: SIM118  it is no dictionary
        if node.props.type(key) == mi.Properties.Type.ResolvedReference:
            children.append((key, _node(mi, state, node.props[key].index())))
        else:
            properties[key] = node.props[key]
    kind = str(node.type).rpartition(".")[2]
    plugin = node.props.plugin_name()
    return _Node(plugin, kind, node.props.id() or _called(plugin, properties), properties, tuple(children))


def _called(plugin: str, properties: dict[str, Any]) -> str:
    """The name of what has none: its file's, or its plugin's."""
    return Path(properties["filename"]).stem if "filename" in properties else plugin


def _refuse_groups(path: Path, root: _Node) -> None:
    """What would be other shapes in Mitsuba's list than in the file's."""
    groups = [shape for shape in root.of("Shape") if shape.plugin in ("shapegroup", "instance", "merge")]
    if groups:
        named = "; ".join(f"{shape.name}: {shape.plugin}" for shape in groups)
        raise FileError(f"{path}: {named}: the model has no instances")


def _check(found: Import, node: _Node) -> None:
    """Refuse what fills space."""
    for _, child in node.children:
        if child.kind in ("Medium", "Volume"):
            found.refuse(child.name, f"{child.plugin}, a {child.kind.lower()}")
        _check(found, child)


def _transport(found: Import, root: _Node) -> None:
    """Note what an integrator leaves out of the picture, in a line."""
    limits: list[str] = []
    pending = [*root.of("Integrator")]
    for node in pending:
        inner = [*node.of("Integrator")]
        pending += inner
        if not inner and node.plugin not in _WHOLE:
            limits.append(node.plugin)
        if node.properties.get("max_depth", -1) >= 0:
            limits.append(f"max_depth = {node.properties['max_depth']}")
        if node.properties.get("hide_emitters", False):
            limits.append("hide_emitters")
    if limits:
        found.assume(f"full light transport and lamps in sight, whatever the integrator says: {', '.join(limits)}")


def _shape(mi: Any, found: Import, node: _Node, shape: Any) -> None:
    """Add a shape with its surface and radiance; a sphere that shines is a light."""
    normals = None
    matrix = _matrix(node)
    images = _Images(found, _own_places(node, shape))
    emission: Color | Texture = BLACK
    try:
        for emitter in node.of("Emitter"):
            emission = _area(mi, images, node, emitter, shape)
        material = _material(mi, images, node, shape)
    except FileError:
        raise
    except ValueError as error:  # of a texel that the model refuses
        raise FileError(f"{found.path}: {node.name}: {error}") from None
    flipped = node.properties.get("flip_normals", False)
    if node.plugin == "sphere":
        center, radius = _ball(found, node, matrix)
        flipped ^= bool(np.linalg.det(matrix[:3, :3]) < 0.0)  # a mirrored sphere looks inwards
        if any(largest(emission)) and not flipped:
            if any(largest(material.color)) or largest(material.gloss) > 0.0 or material.transparency > 0.0:
                found.instead(node.name, "a lamp that reflects", "a black one")
            assert not isinstance(emission, Texture)  # on a sphere no image lies
            found.lights.append(SphereLight(tuple(center.tolist()), radius, emission))
            return
        points, faces, normals = _icosphere(found, node, center, radius)
    elif node.plugin in _MESHES:
        points = np.array(shape.vertex_positions_buffer(), np.float64).reshape(-1, 3)
        faces = np.array(shape.faces_buffer(), np.int64).reshape(-1, 3)
        if shape.has_vertex_normals():
            normals = np.array(shape.vertex_normals_buffer(), np.float64).reshape(-1, 3)
    elif node.plugin in ("rectangle", "disk"):
        points, faces = _polygon(found, node)
        normals = np.broadcast_to(np.linalg.inv(matrix[:3, :3])[2], points.shape)
        points = _placed(matrix, points)
    else:
        raise found.refuse(node.name, f"{node.plugin}, a shape")
    if any(largest(emission)) and normals is not None:
        if node.plugin != "sphere":
            faces = found.outwards(node.name, points, faces, normals)
        normals = None
    if flipped:
        faces, normals = faces[:, ::-1], None if normals is None else -normals
    uv = None if images.places is None else images.places[faces]
    found.add(node.name, points, faces, material, normals=normals, emission=emission, uv=uv)


def _own_places(node: _Node, shape: Any) -> np.ndarray | None:
    """Where in an image Mitsuba has the points of a shape, (V, 2), v downwards; None where the model has none of it."""
    if node.plugin == "rectangle":
        return _ON_RECTANGLE
    if node.plugin in _MESHES and shape.has_vertex_texcoords():
        return np.array(shape.vertex_texcoords_buffer(), np.float64).reshape(-1, 2)
    return None


def _material(mi: Any, images: _Images, node: _Node, shape: Any) -> Material:
    """Surface of a shape; without one Mitsuba takes a grey, which for a lamp is black."""
    surfaces = [*node.of("BSDF")]
    if not surfaces:
        return _default(mi, images.found, node, shape)
    return _surface(mi, images, node.name, surfaces[0], shape.bsdf())


def _scale(matrix: np.ndarray) -> float | None:
    """The factor of a similarity; None of a matrix that squeezes or shears."""
    square = matrix[:3, :3].T @ matrix[:3, :3]
    scale = float(np.sqrt(np.trace(square) / 3.0))
    return scale if np.abs(square - scale**2 * np.eye(3)).max() <= _TINY * scale**2 else None


def _ball(found: Import, node: _Node, matrix: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre (3,) and radius of a sphere; of one that is squeezed Mitsuba makes a ball, as wide as along x."""
    center = np.array(node.properties.get("center", (0.0, 0.0, 0.0)), np.float64).ravel()
    radius, scale = node.properties.get("radius", 1.0), _scale(matrix)
    if scale is None:
        scale = float(np.linalg.norm(matrix[:3, 0]))
        found.instead(
            node.name,
            "a sphere that to_world squeezes or shears",
            f"the ball of radius {radius * scale:g} that Mitsuba makes of it",
        )
    return _placed(matrix, center), radius * scale


def _matrix(node: _Node) -> np.ndarray:
    given = node.properties.get("to_world")
    return np.eye(4) if given is None else np.array(given.matrix, np.float64)


def _placed(matrix: np.ndarray, points: Any) -> np.ndarray:
    return np.asarray(points, np.float64) @ matrix[:3, :3].T + matrix[:3, 3]


def _polygon(found: Import, node: _Node) -> tuple[np.ndarray, np.ndarray]:
    """Points and faces of a rectangle, or of those that stand for a disk, before it is placed."""
    if node.plugin == "rectangle":
        return np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]]), np.array(
            [[0, 1, 2], [0, 2, 3]]
        )
    found.instead(node.name, "disk", f"a polygon of {_DISK} corners")
    angle = 2.0 * np.pi * np.arange(_DISK) / _DISK
    last = np.arange(1, _DISK - 1)
    rim = np.stack([np.cos(angle), np.sin(angle), np.zeros(_DISK)], axis=1)
    return rim, np.stack([0 * last, last, last + 1], axis=1)


def _icosphere(
    found: Import, node: _Node, center: np.ndarray, radius: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, faces and normals of triangles that stand for a sphere."""
    from trimesh import creation  # takes seconds to load

    found.instead(node.name, "sphere", f"{20 * 4**_SPHERE} triangles with its normals")
    ball = creation.icosphere(subdivisions=_SPHERE)
    unit = np.asarray(ball.vertices, np.float64)
    return center + radius * unit, np.asarray(ball.faces, np.int64), unit


def _default(mi: Any, found: Import, node: _Node, shape: Any) -> Material:
    if shape.is_emitter():
        found.instead(node.name, "a lamp whose surface is Mitsuba's grey", "a black one")
        return BLACK_SURFACE
    found.instead(node.name, "diffuse on one side, for it has no bsdf", "the same on both sides")
    return Material(_reflectance(mi, shape.bsdf()), 0.0)


def _surface(mi: Any, images: _Images, name: str, node: _Node, made: Any) -> Material:
    """The material of a BSDF; what is not diffuse and two-sided has a stand-in, or is refused."""
    found = images.found
    name = f"{name}: bsdf {node.name}" if node.name != node.plugin else name
    if (leaf := _leaf(mi, images, name, node, made, "")) is not None:
        return leaf
    if node.plugin in _GLASS:
        return _glass(mi, found, name, node, made, "")
    kinds = [child.plugin for child in node.of("BSDF")]
    if node.plugin == "blendbsdf" and kinds[1] in _GLASS:
        first, second = node.of("BSDF")
        return _over_diffuse(mi, images, name, first, _glass(mi, found, name, second, made, "bsdf_1."), made)
    if node.plugin == "blendbsdf" and kinds == ["blendbsdf", "twosided"]:
        first, second = node.of("BSDF")
        if (leaf := _leaf(mi, images, name, first, made, "bsdf_0.")) is not None:
            lobe = _glossy(mi, images, name, next(second.of("BSDF")), made, "bsdf_1.brdf_0.")
            gloss = _within(images.number(name, node, "weight", mi.traverse(made), ""), 0.0, 1.0)
            return attrs.evolve(lobe, color=leaf.color, translucency=leaf.translucency, gloss=gloss)
    inner, sides = node, 1
    if node.plugin == "twosided":
        both = [*node.of("BSDF")]
        inner, sides = both[0], 2
        if len(both) > 1:
            found.instead(name, "twosided with two surfaces", "the first on both sides")
    prefix = "brdf_0." if node.plugin == "twosided" else ""
    if inner.plugin == "diffuse":
        color = _reflects(mi, images, name, inner, "reflectance", made, prefix)
        if sides == 1 and any(largest(color)):
            found.instead(name, "diffuse on one side", "the same on both sides")
        return Material(color, 0.0)
    material = _glossy(mi, images, name, inner, made, prefix)
    if sides == 1:
        found.instead(name, f"{inner.plugin} on one side", "the same on both sides")
    return material


def _over_diffuse(mi: Any, images: _Images, name: str, node: _Node, glass: Material, made: Any) -> Material:
    """The material of the blend `made` of a diffuse surface of two sides, `node`, and glass.

    Those of ours are g, t and (1 - g) (1 - t), of the diffuse part by its colour. None of them is an image.
    """
    parameters, found = mi.traverse(made), images.found
    leaf = _leaf(mi, images, name, node, made, "bsdf_0.", plain=True)
    diffuse = node.plugin == "twosided" and [child.plugin for child in node.of("BSDF")] == ["diffuse"]
    if (leaf is None and not diffuse) or "weight.value" not in parameters:
        raise found.refuse(name, f"a blend of {node.plugin} and glass")
    share = _color(parameters["weight.value"])[0]
    gloss, transparency = share * largest(glass.gloss), share * glass.transparency
    left = (1.0 - gloss) * (1.0 - transparency)
    inner = next(node.of("BSDF"))
    color = leaf.color if leaf is not None else images.plain(name, inner, "reflectance", parameters, "bsdf_0.brdf_0.")
    shown = np.array(color) * ((1.0 - share) / left if left else 0.0)
    if (shown > 1.0 + _TINY).any():
        raise found.refuse(name, "a blend with glass in which the diffuse part is brighter than white")
    return attrs.evolve(
        glass,
        color=tuple(np.clip(shown, 0.0, 1.0).tolist()),
        translucency=0.0 if leaf is None else leaf.translucency,
        gloss=gloss,
        transparency=transparency,
    )


def _glass(mi: Any, found: Import, name: str, node: _Node, made: Any, prefix: str) -> Material:
    """The material of what Mitsuba lets light through by a rough or a smooth face between two media.

    `prefix` leads to the parameters of the node from those of the BSDF `made`.
    """
    every = mi.traverse(made)
    parameters = {key.removeprefix(prefix): every[key] for key in every.keys() if key.startswith(prefix)}
    rough = node.plugin == "roughdielectric"
    for feature in ("specular_reflectance", "specular_transmittance", "alpha"):
        if (texture := node.textured(feature)) is not None:
            raise found.refuse(name, f"{texture}, a texture of {feature} of {node.plugin}")
    if {"alpha_u", "alpha_v"} & set(node.properties):
        raise found.refuse(name, "alpha_u and alpha_v of roughdielectric")
    kind = node.properties.get("distribution", "beckmann") if rough else "smooth"
    alpha = _color(parameters["alpha.value"])[0] if rough else SMOOTH
    roughness = float(np.clip(alpha, SMOOTH, 1.5))
    of_alpha = "of the same alpha" if roughness == alpha else f"of alpha {roughness:g}"
    like = f"Beckmann's {of_alpha}, Smith's masking exact" if rough else f"roughness {SMOOTH:g}"
    found.instead(name, f"{node.plugin} ({kind})", like)
    colors = [
        np.array(_color(parameters[key])) if (key := f"{feature}.value") in parameters else np.ones(3)
        for feature in ("specular_reflectance", "specular_transmittance")
    ]
    gloss, transparency = (float(each.max()) for each in colors)
    if np.ptp(colors[0]) > 0.0:
        found.instead(name, "specular_reflectance of a colour", "its largest channel")
    tint = _color(colors[1] / transparency) if transparency > 0.0 else (1.0, 1.0, 1.0)
    ior = _color(parameters["eta"])[0]
    return Material(BLACK, gloss, roughness, transparency=transparency, ior=ior, tint=tint, fresnel="dielectric")


def _leaf(
    mi: Any, images: _Images, name: str, node: _Node, made: Any, prefix: str, *, plain: bool = False
) -> Material | None:
    """The material of a blend of `diffuse`, two-sided, and the transmitted part of `principledthin`, of one colour.

    None of any other. `prefix` leads to the parameters of the node from those of the BSDF `made`; `plain`: an image is
    its mean.
    """
    if node.plugin != "blendbsdf" or [child.plugin for child in node.of("BSDF")] != ["twosided", "principledthin"]:
        return None
    sides, thin = node.of("BSDF")
    inner = [*sides.of("BSDF")]
    values = mi.traverse(made)
    share, all_of_it = (values.get(f"{prefix}{key}.value") for key in ("weight", "bsdf_1.diff_trans"))
    if [child.plugin for child in inner] != ["diffuse"] or share is None or all_of_it is None:
        return None
    said = {*thin.properties, *(feature for feature, _ in thin.children)}
    if said - {"base_color", "diff_trans"} or (np.array(all_of_it) != 2.0).any():
        return None
    stays, crosses = f"{prefix}bsdf_0.brdf_0.", f"{prefix}bsdf_1."
    for key in ("value", "data", "to_uv"):
        first, second = values.get(f"{stays}reflectance.{key}"), values.get(f"{crosses}base_color.{key}")
        if key == "to_uv" and first is not None and second is not None:
            first, second = first.matrix, second.matrix
        if (first is None) != (second is None) or not np.array_equal(np.array(first), np.array(second)):
            return None
    textures = inner[0].texture("reflectance"), thin.texture("base_color")
    for key in ("wrap_mode", "filter_type"):
        if len({each.properties.get(key) for each in textures if each is not None}) > 1:
            return None
    read = images.plain if plain else images.color
    return Material(read(name, inner[0], "reflectance", values, stays), 0.0, translucency=_color(share)[0])


def _glossy(mi: Any, images: _Images, name: str, node: _Node, made: Any, prefix: str) -> Material:
    """Beckmann's lobe with Schlick's reflectance, equal at normal incidence, for lobes that are not exactly that.

    `prefix` leads to the parameters of the node from those of the BSDF `made`.
    """
    parameters, found = mi.traverse(made), images.found

    def value(key: str, *, width: int = 3) -> Any:
        if node.texture(key) is not None:
            mean = np.array(images.plain(name, node, key, parameters, prefix))
            return mean if width == 3 else float(mean @ _LUMINANCE)
        for end in (f"{key}.value", key):
            if prefix + end in parameters:
                given = np.array(_color(parameters[prefix + end]))
                return given if width == 3 else float(given[0])
        raise found.refuse(name, f"nothing for {key} of {node.plugin}")

    def coat(feature: str, metallic: float, f0: float, alpha: float) -> Material:
        """Over the reflectance of a feature; a lobe is of one colour."""
        color = _reflects(mi, images, name, node, feature, made, prefix)
        if metallic > 0.0 and isinstance(color, Texture):
            found.instead(name, f"{feature} of a metal, whose reflectance is an image", "its mean")
        mean = _color(color.texels.mean(axis=(0, 1))) if isinstance(color, Texture) else color
        return attrs.evolve(coated(mean, metallic=metallic, f0=f0, roughness=alpha), color=color)

    if node.plugin in _CONDUCTORS:
        rough = node.plugin == "roughconductor"
        alpha: float | Texture = MIRROR
        if {"alpha_u", "alpha_v"} & set(node.properties):
            found.instead(name, "alpha_u and alpha_v", "their mean")
            alpha = (value("alpha_u", width=1) + value("alpha_v", width=1)) / 2.0
        elif rough:
            alpha = images.number(name, node, "alpha", parameters, prefix)
        f0 = _conductor(value("eta"), value("k"))
        if f"{prefix}specular_reflectance.value" in parameters or node.texture("specular_reflectance") is not None:
            f0 = f0 * value("specular_reflectance")
        kind = node.properties.get("distribution", "beckmann") if rough else "a mirror"
        widened = "" if least(alpha) >= MIRROR and rough else f", of alpha {MIRROR:g} at least"
        lobe = f"Beckmann's lobe with Schlick's reflectance of the same f0{widened}"
        found.instead(name, f"{node.plugin} ({kind})", lobe)
        return Material(BLACK, 1.0, _within(alpha, MIRROR, 1.5), _color(np.clip(f0, 0.0, 1.0)))
    if node.plugin in _COATED:
        index = value("eta", width=1)
        found.instead(name, node.plugin, "a lobe over a diffuse base, equal at normal incidence")
        roughness = MIRROR if node.plugin == "plastic" else value("alpha", width=1)
        return coat("diffuse_reflectance", 0.0, _of_index(index), roughness)
    if node.plugin == "principled":
        if value("spec_trans", width=1) > 0.0:
            raise found.refuse(name, "principled with spec_trans, which transmits light")
        found.instead(name, "principled", "a lobe over a diffuse base, equal at normal incidence")
        metallic, roughness = value("metallic", width=1), value("roughness", width=1)
        f0 = (
            0.08 * value("specular", width=1) if f"{prefix}specular" in parameters else _of_index(value("eta", width=1))
        )
        return coat("base_color", metallic, f0, roughness**2)
    if node.plugin == "blendbsdf" and [child.plugin for child in node.of("BSDF")] == ["diffuse", "roughconductor"]:
        first, second = node.of("BSDF")
        lobe = _glossy(mi, images, name, second, made, f"{prefix}bsdf_1.")
        color = images.color(name, first, "reflectance", parameters, f"{prefix}bsdf_0.")
        gloss = _within(images.number(name, node, "weight", parameters, prefix), 0.0, 1.0)
        return attrs.evolve(lobe, color=color, gloss=gloss)
    raise found.refuse(name, node.plugin)


def _within(value: float | Texture, low: float, high: float) -> float | Texture:
    """A number, or an image of them, cut to a range."""
    if isinstance(value, Texture):
        return Texture(np.clip(value.texels, low, high), value.wrap)
    return float(np.clip(value, low, high))


def _conductor(eta: np.ndarray, k: np.ndarray) -> np.ndarray:
    """Reflectance at normal incidence, `((n - 1)² + k²) / ((n + 1)² + k²)`."""
    return ((eta - 1.0) ** 2 + k**2) / ((eta + 1.0) ** 2 + k**2)


def _of_index(index: float) -> float:
    return ((index - 1.0) / (index + 1.0)) ** 2


def _reflects(
    mi: Any, images: _Images, name: str, node: _Node, feature: str, made: Any, prefix: str
) -> Color | Texture:
    """Diffuse reflectance that a feature of a BSDF says; the mean of a texture that is no image."""
    texture, parameters = node.textured(feature), mi.traverse(made)
    if texture == "bitmap":
        return images.color(name, node, feature, parameters, prefix)
    if texture is None:
        values = [value for name, value in parameters.items() if name.endswith(f"{feature}.value")]
        if len(values) == 1:
            return _color(values[0])  # to evaluate it would be a kernel for each surface
    _refuse_attribute(images.found, name, texture)
    if texture is not None:
        images.found.instead(name, f"{texture}, a texture of {feature}", "its mean")
    return _reflectance(mi, made)


def _refuse_attribute(found: Import, name: str, texture: str | None) -> None:
    """Of what a mesh says at its vertices the unit square knows nothing."""
    if texture == "mesh_attribute":
        raise found.refuse(name, f"{texture}, a texture")


def _reflectance(mi: Any, made: Any) -> Color:
    """Diffuse reflectance of a BSDF, its mean over the unit square of u and v."""
    return _color(np.clip(_over_square(mi, made.eval_diffuse_reflectance), 0.0, 1.0))


def _over_square(mi: Any, evaluated: Callable[[Any], Any]) -> np.ndarray:
    """Mean (3,) of a function of an interaction over the unit square of u and v."""
    centres = (np.arange(_GRID) + 0.5) / _GRID
    grid = np.stack([each.ravel() for each in np.meshgrid(centres, centres)])
    si = mi.SurfaceInteraction3f()
    si.wi = mi.Vector3f(0.0, 0.0, 1.0)
    values = []
    for uv in grid.T if mi.variant().startswith("scalar") else [grid]:
        si.uv = mi.Point2f(uv)
        values.append(np.array(evaluated(si), np.float64).T.reshape(-1, 3))
    return np.concatenate(values).mean(axis=0)


def _area(mi: Any, images: _Images, node: _Node, emitter: _Node, shape: Any) -> Color | Texture:
    """Radiance of a lamp; the mean of a texture that is no image."""
    if emitter.plugin != "area":
        raise images.found.refuse(node.name, f"{emitter.plugin}, an emitter of a shape")
    texture, parameters = emitter.textured("radiance"), mi.traverse(shape.emitter())
    if texture == "bitmap":
        return images.color(node.name, emitter, "radiance", parameters, "")
    if "radiance.value" in parameters:
        return _color(parameters["radiance.value"])
    _refuse_attribute(images.found, node.name, texture)
    if texture is not None:
        images.found.instead(node.name, f"{texture}, a texture of radiance", "its mean")
    return _color(_over_square(mi, shape.emitter().eval))


def _color(value: Any) -> Color:
    """Three numbers, or one for all, of Mitsuba's float32: 0.35 as it stood in the file, not 0.3499999940."""
    given = np.resize(np.array(value, np.float32).ravel(), 3)
    # Not by `str`, which gives six digits after np.set_printoptions(legacy="1.13"): importing colour-science does that.
    red, green, blue = (float(np.format_float_scientific(each)) for each in given)
    return red, green, blue


def _emitter(mi: Any, found: Import, node: _Node, made: Any) -> None:
    """Add a light that is no shape's."""
    if node.plugin == "point":
        place = np.array(node.properties.get("position", (0.0, 0.0, 0.0)), np.float64).ravel()
        intensity = _color(mi.traverse(made)["intensity.value"])
        found.lights.append(PointLight(tuple(_placed(_matrix(node), place).tolist()), intensity))
    elif node.plugin == "spot":
        if (texture := node.textured("texture")) is not None:
            found.instead(node.name, f"{texture}, a texture of a spot light", "none")
        matrix, cutoff = _matrix(node), node.properties.get("cutoff_angle", 20.0)
        place, target = matrix[:3, 3], matrix[:3, 3] + matrix[:3, 2]
        intensity = _color(mi.traverse(made)["intensity.value"])
        beam = min(node.properties.get("beam_width", 0.75 * cutoff), cutoff)  # beyond the cutoff all is dark
        found.lights.append(SpotLight(tuple(place.tolist()), tuple(target.tolist()), intensity, cutoff, beam))
    elif node.plugin == "directional":
        way = np.array(node.properties.get("direction", _matrix(node)[:3, 2]), np.float64).ravel()
        found.lights.append(DirectionalLight(tuple(way.tolist()), _color(mi.traverse(made)["irradiance.value"])))
    elif node.plugin == "constant":
        found.sky = Sky(color=_color(_toward(mi, made, np.array([[0.0, 0.0, 1.0]]))))
    elif node.plugin == "envmap":
        found.instead(node.name, "envmap", f"a panorama of {2 * _MAP} x {_MAP} texels")
        found.sky = Sky(texture=_panorama(mi, made), radius=math.inf, projection="lat-long")
    else:
        found.instead(node.name, f"{node.plugin}, a light", "none in its place")


def _toward(mi: Any, sky: Any, directions: np.ndarray) -> np.ndarray:
    """Radiance (N, 3) of an environment along unit directions (N, 3)."""
    si = mi.SurfaceInteraction3f()
    if not mi.variant().startswith("scalar"):
        si.wi = mi.Vector3f(-directions.T)
        return np.array(sky.eval(si), np.float64).T.reshape(-1, 3) + np.zeros((len(directions), 1))
    values = np.empty((len(directions), 3))
    for number, direction in enumerate(directions):
        si.wi = mi.Vector3f(*(-direction).tolist())
        values[number] = np.array(sky.eval(si))
    return values


def _panorama(mi: Any, sky: Any) -> np.ndarray:
    """Texels (H, 2 H, 3) float32 of `scenes.model.Sky`, lat-long."""
    v, u = np.meshgrid(
        np.pi * (np.arange(_MAP) + 0.5) / _MAP, np.pi * ((np.arange(2 * _MAP) + 0.5) / _MAP - 1.0), indexing="ij"
    )
    directions = np.stack([np.sin(v) * np.sin(u), np.sin(v) * np.cos(u), np.cos(v)], axis=-1)
    return _toward(mi, sky, directions.reshape(-1, 3)).reshape(*v.shape, 3).astype(np.float32)


def _sensor(mi: Any, found: Import, node: _Node, made: Any) -> None:
    """The camera and the size of its film."""
    if node.plugin == "thinlens":
        found.instead(node.name, "thinlens", "a pinhole")
    elif node.plugin != "perspective":
        raise found.refuse(node.name, f"{node.plugin}, a sensor")
    parameters = mi.traverse(made)
    for axis in "xy":
        if node.properties.get(f"principal_point_offset_{axis}", 0.0) != 0.0:
            raise found.refuse(node.name, f"principal_point_offset_{axis}")
    width, height = np.array(parameters["film.size"]).ravel().tolist()
    if np.array(parameters["film.crop_size"]).ravel().tolist() != [width, height]:
        raise found.refuse(node.name, "a film that is cropped")
    found.resolution = int(width), int(height)
    matrix = _matrix(node)
    turned = matrix[:3, :3] / np.linalg.norm(matrix[:3, :3], axis=0)
    if np.abs(turned.T @ turned - np.eye(3)).max() > _TINY or np.linalg.det(turned) < 0.0:
        raise found.refuse(node.name, "a to_world that skews or mirrors the picture")
    # Mitsuba's x is to the left; the field of view is across the width, whatever its axis was.
    fov = float(np.array(parameters["x_fov"]).ravel()[0])
    found.camera = look(matrix[:3, 3], turned[:, 2], turned[:, 1], _precise(node, fov, width / height))
    filters = [child for film in node.of("Film") for child in film.of("ReconstructionFilter")]
    kind = filters[0].plugin if filters else "gaussian"  # Mitsuba's own
    if kind != "box":
        found.instead(node.name, f"{kind}, a pixel filter", "a box of a pixel")
    near, far = (float(np.array(parameters[f"{name}_clip"]).ravel()[0]) for name in ("near", "far"))
    found.clipped(found.camera, near, far)


def _precise(node: _Node, fov: float, aspect: float) -> float:
    """The field of view across the width in all digits of the file, where its axis is plain; else in float32."""
    given, axis = node.properties.get("fov"), node.properties.get("fov_axis", "x")
    across = axis == "x" or (axis == "smaller" and aspect <= 1.0) or (axis == "larger" and aspect >= 1.0)
    return float(given) if given is not None and across else fov
