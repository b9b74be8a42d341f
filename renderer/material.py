"""What a surface does to light where a ray meets it, the weights of `color (1 - g) (1 - t) / pi + g f_r + t tint f_t`.

Of the diffuse part w = color (1 - g) (1 - t) the share s, the translucency, is of the other side:
`w ((1 - s) L(n) + s L(-n))`, L any term about a normal, n on the viewer's side. Samples choose a side with its share;
what has no number to choose by, or sees both sides for the price of one, adds them.

The only reader of `SceneArrays.materials`. A reader is given the place, face and barycentrics, and not the object: what
varies over a surface is a matter of this file alone, and of `renderer.textures`, which looks images up. Each reads no
more than its caller asks for.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from termwise.renderer import textures
from termwise.renderer.by_reference import by_reference
from termwise.renderer.dielectric import REFLECTED, REFRACTED, Interface
from termwise.renderer.jit import device
from termwise.renderer.textures import Textures, color_at, number_at
from termwise.renderer.triangles import shading_normal
from termwise.renderer.unoccluded import open_sides
from termwise.renderer.vector import Vec3, dot, is_black, negate, scale, vec3
from termwise.renderer.warp import square_to_cosine_hemisphere
from termwise.scenes.model import Scene, largest

if TYPE_CHECKING:  # they hold what is defined here
    from termwise.renderer.arrays import SceneArrays
    from termwise.renderer.surface import Surface


@by_reference(transmission=(3,))
class Dielectrics(NamedTuple):
    """The surfaces of each object that reflect, and let through, as dielectrics do.

    Attributes
    ----------
    here : (O,) bool, which they are.
    ior : (O,), inside over outside.
    opaque : (O,) bool, whether they let nothing through: both sides are then outside.
    transmission : (O, 3), transparency times tint.
    """

    here: np.ndarray
    ior: np.ndarray
    opaque: np.ndarray
    transmission: np.ndarray


@by_reference(color=(3,), diffuse=(3,), f0=(3,), emission=(3,), open=(2,), passing=(3,))
class Materials(NamedTuple):
    """What surfaces of each object do to light, the spheres' behind the others; emitters are black.

    Where an image stands in the place of a colour or a number it is the largest of its texels, and `diffuse` a bound.

    Attributes
    ----------
    color : (O, 3).
    diffuse : (O, 3), color (1 - gloss) (1 - transparency).
    specular : (O,), gloss.
    alpha : (O,), Beckmann roughness.
    f0 : (O, 3), Schlick's reflectance at normal incidence.
    emission : (O, 3), radiance of the front side.
    open : (O, 2) bool, whether nothing can lie within the ambient range of the object's front, and of its back.
    textures : the images, or None of a scene that has none: its kernels are compiled without.
    translucency : (O,), share of the diffuse part that crosses; None of a scene that has no such object, whose kernels
        are compiled without.
    dielectrics : None of a scene that has none; so are its kernels.
    passing : (O, 3), what is left beyond of light on shadow and occlusion rays, and on a photon's way from its light; 0
        behind what occludes. None of a scene in which all does; so are its kernels.
    """

    color: np.ndarray
    diffuse: np.ndarray
    specular: np.ndarray
    alpha: np.ndarray
    f0: np.ndarray
    emission: np.ndarray
    open: np.ndarray
    textures: Textures | None
    translucency: np.ndarray | None
    dielectrics: Dielectrics | None
    passing: np.ndarray | None


_BELOW_ONE = 1.0 - 2.0**-53


def from_scene(scene: Scene, without: Collection[str]) -> Materials:
    """The materials of a scene's objects; `without`: see `arrays.from_scene`."""
    surfaces = scene.surfaces
    emission = [*(largest(thing.emission) for thing in scene.objects), *(sphere.radiance for sphere in scene.spheres)]
    lit = scene.toggles.lighting
    return Materials(
        np.array([largest(surface.color) for surface in surfaces]).reshape(-1, 3),
        np.array([scene.diffuse_weight(surface) for surface in surfaces]).reshape(-1, 3),
        np.array([scene.specular_weight(surface) for surface in surfaces]).reshape(-1),
        np.array([largest(surface.roughness) for surface in surfaces]).reshape(-1),
        np.array([surface.f0 for surface in surfaces]).reshape(-1, 3),
        np.array([each if lit else (0.0, 0.0, 0.0) for each in emission]).reshape(-1, 3),
        _open(scene, without),
        textures.from_scene(scene),
        np.array([surface.translucency for surface in surfaces]) if scene.translucent else None,
        _dielectrics(scene),
        np.array([scene.passing_weight(surface) for surface in surfaces]) if scene.unshadowing else None,
    )


def _dielectrics(scene: Scene) -> Dielectrics | None:
    surfaces = scene.surfaces
    if not any(surface.dielectric for surface in surfaces):
        return None
    return Dielectrics(
        np.array([surface.dielectric for surface in surfaces]),
        np.array([surface.ior for surface in surfaces]),
        np.array([surface.transparency == 0.0 for surface in surfaces]),
        np.array([scene.transmission_weight(surface) for surface in surfaces]),
    )


def _open(scene: Scene, without: Collection[str]) -> np.ndarray:
    """What `Materials.open` is; a sphere is black, and nothing asks it."""
    spheres = np.zeros((len(scene.spheres), 2), np.bool_)
    return np.concatenate(
        [np.zeros((len(scene.objects), 2), np.bool_) if "open" in without else open_sides(scene), spheres]
    )


@device
def whole_color(scene: SceneArrays, surface: Surface) -> Vec3:
    """Color, whatever the gloss: the weight of the ambient light in the paper's shadow."""
    return _color(scene.materials, scene.materials.textures, surface)


@device
def _color(materials: Materials, images: Textures | None, surface: Surface) -> Vec3:
    if images is not None and images.color[surface.object] >= 0:
        return color_at(images, images.color[surface.object], surface.face, surface.b1, surface.b2)
    return vec3(materials.color, surface.object)


@device
def diffuse_weight(scene: SceneArrays, surface: Surface) -> Vec3:
    """Weight of the diffuse lobe, its albedo."""
    return _diffuse(scene.materials, scene.materials.textures, surface)


@device
def _diffuse(materials: Materials, images: Textures | None, surface: Surface) -> Vec3:
    if images is not None and (images.color[surface.object] >= 0 or images.gloss[surface.object] >= 0):
        return scale(_color(materials, images, surface), 1.0 - _gloss(materials, images, surface))
    return vec3(materials.diffuse, surface.object)


@device
def holds_photons(scene: SceneArrays, surface: Surface) -> bool:
    """Whether photons are kept that land there: anywhere on an object that is not black in the diffuse part.

    Not where the image is, for a density at one point counts what has landed around it.
    """
    return not is_black(vec3(scene.materials.diffuse, surface.object))


@device
def specular_weight(scene: SceneArrays, surface: Surface) -> float:
    """Weight of the Cook-Torrance lobe."""
    return _gloss(scene.materials, scene.materials.textures, surface)


@device
def _gloss(materials: Materials, images: Textures | None, surface: Surface) -> float:
    if images is not None and images.gloss[surface.object] >= 0:
        return number_at(images, images.gloss[surface.object], surface.face, surface.b1, surface.b2)
    return materials.specular[surface.object]


@device
def lobe_alpha(scene: SceneArrays, surface: Surface) -> float:
    """Beckmann roughness of the lobe."""
    return _alpha(scene.materials, scene.materials.textures, surface)


@device
def _alpha(materials: Materials, images: Textures | None, surface: Surface) -> float:
    if images is not None and images.roughness[surface.object] >= 0:
        return number_at(images, images.roughness[surface.object], surface.face, surface.b1, surface.b2)
    return materials.alpha[surface.object]


@device
def lobe_f0(scene: SceneArrays, surface: Surface) -> Vec3:
    """Reflectance of the lobe's microfacets at normal incidence."""
    return vec3(scene.materials.f0, surface.object)


@device
def chain_ends(dielectrics: Dielectrics | None, way: int, gloss: float, surface: Surface) -> bool:
    """Whether a surface has none of the lobes that a chain may go on with, which `way` says (see `dielectric`)."""
    if dielectrics is not None and way != REFLECTED:
        opaque = dielectrics.opaque[surface.object]
        return opaque and (gloss == 0.0 or way == REFRACTED)
    return gloss == 0.0 or way == REFRACTED  # it refracts nothing


@device
def interface(scene: SceneArrays, dielectrics: Dielectrics, gloss: float, surface: Surface) -> Interface:
    """The lobes of a dielectric's surface, from the side that it is seen from."""
    thing = surface.object
    eta = dielectrics.ior[thing]
    if not dielectrics.opaque[thing]:
        outwards = shading_normal(scene.geometry, surface.face, surface.b1, surface.b2)
        if dot(outwards, surface.normal) < 0.0:
            eta = 1.0 / eta
    return Interface(lobe_alpha(scene, surface), eta, gloss, vec3(dielectrics.transmission, thing))


@device
def emission(scene: SceneArrays, face: int, b1: float, b2: float) -> Vec3:
    """Radiance of the front of a face at a point of it, which need not be one that a ray has met."""
    return _emission(scene.materials, scene.materials.textures, scene.geometry.object[face], face, b1, b2)


@device
def _emission(materials: Materials, images: Textures | None, thing: int, face: int, b1: float, b2: float) -> Vec3:
    if images is not None:
        return _emitted(materials, images, images.emission, thing, face, b1, b2)
    return vec3(materials.emission, thing)


@device
def _emitted(
    materials: Materials, images: Textures, emission: np.ndarray | None, thing: int, face: int, b1: float, b2: float
) -> Vec3:
    if emission is not None and emission[thing] >= 0:
        return color_at(images, emission[thing], face, b1, b2)
    return vec3(materials.emission, thing)


# Numba leaves out a branch that asks an argument of type None whether it is None, and compiles nothing behind it.


@device
def side_of(share: float, u: float) -> tuple[bool, float]:
    """Whether a sample is of the other side, which has a share of them, and what is left of its number, in [0, 1)."""
    crosses = u < share
    left = u / share if crosses else (u - share) / (1.0 - share)
    return crosses, min(left, _BELOW_ONE)


@device
def sampled_side(translucency: np.ndarray | None, surface: Surface, u: float) -> tuple[Vec3, float]:
    """The normal of the side that a sample is of, and what is left of its number."""
    if translucency is None:
        return surface.normal, u
    crosses, u = side_of(translucency[surface.object], u)
    return negate(surface.normal) if crosses else surface.normal, u


@device
def scattered(translucency: np.ndarray | None, surface: Surface, u: float, v: float) -> Vec3:
    """Direction of diffuse light about the normal: of density |cos| / pi times the share of its side."""
    if translucency is None:
        return square_to_cosine_hemisphere(u, v)
    crosses, u = side_of(translucency[surface.object], u)
    local = square_to_cosine_hemisphere(u, v)
    return Vec3(local.x, local.y, -local.z) if crosses else local


@device
def sees_all_ambient(scene: SceneArrays, surface: Surface) -> bool:
    """Whether nothing can lie within the ambient range of the side that is seen, nor of one that light crosses from."""
    return _sees_all(scene, scene.materials.translucency, surface)


@device
def _sees_all(scene: SceneArrays, translucency: np.ndarray | None, surface: Surface) -> bool:
    front = surface.side > 0.0 or not scene.face_forward
    sees = scene.materials.open[surface.object, 0 if front else 1]
    if translucency is not None and translucency[surface.object] > 0.0:
        return sees and scene.materials.open[surface.object, 1 if front else 0]
    return sees
