"""Density of photons: `E(x) = sum_p Phi_p K(|x_p - x|) / M(x)`, over the photons p of x's surface, on its side.

Eight photons at a time where the processor has vectors. Where it has none a range of photons is summed in eight lanes
all the same, so that both give the same bits.
"""

import numpy as np

from termwise.renderer.arrays import SceneArrays
from termwise.renderer.geometry import simd
from termwise.renderer.geometry.simd import bits, choose, load, load_ints, lowest_bit, numbers, rows, splat, store
from termwise.renderer.jit import device, subroutine
from termwise.renderer.kernel_mass import falloff, kernel_mass, peak, same_surface
from termwise.renderer.photon_map import PhotonMap, cells_within, range_of
from termwise.renderer.scratch import DENSITY_ESTIMATES, Scratch
from termwise.renderer.surface import Surface
from termwise.renderer.triangles import Geometry
from termwise.renderer.vector import Vec3, column, dot, entry, is_black, scale, sub, vec3


@device
def estimate_irradiance(scene: SceneArrays, photons: PhotonMap, surface: Surface, scratch: Scratch) -> Vec3:
    """E at a surface point by the map's kernel, divided by its mass on the surface."""
    # Asked here, where there are none not even the call is made.
    if len(photons.face) == 0:
        return Vec3(0.0, 0.0, 0.0)
    return _estimate(scene, photons, surface, scratch)


@subroutine
def _estimate(scene: SceneArrays, photons: PhotonMap, surface: Surface, scratch: Scratch) -> Vec3:
    scratch.counts[DENSITY_ESTIMATES] += 1
    x, radius = surface.point, photons.radius
    flux = _weighted_flux(scene.geometry, photons, surface, scratch.lanes)
    if is_black(flux):
        return flux
    mass = kernel_mass(scene, surface.face, x, radius, photons.exponent, scratch.stack)
    return scale(flux, peak(radius, photons.exponent) / mass)


@device
def _weight(geometry: Geometry, photons: PhotonMap, p: int, surface: Surface, own: Vec3, rest: float) -> float:
    """Weight of photon p, which lies within the radius, at a point of a face whose normal is `own`."""
    face = entry(photons.face, p)
    normal = vec3(geometry.normals, face)
    offset = sub(column(photons.position, p), surface.point)
    if not same_surface(geometry.object, surface.face, own, face, normal, offset, photons.radius):
        return 0.0
    wi = column(photons.direction, p)
    cos = dot(wi, normal)
    if cos * surface.side <= 0.0:
        return 0.0
    weight = falloff(rest, photons.exponent)
    if geometry.smooth[face]:
        weight *= max(0.0, dot(wi, surface.normal)) / abs(cos)
    return weight


@device
def _total(lanes: np.ndarray, channel: int) -> float:
    total = 0.0
    for lane in range(8):
        total += lanes[channel, lane]
    return total


if simd.available():

    @device
    def _weighted_flux(geometry: Geometry, photons: PhotonMap, surface: Surface, lanes: np.ndarray) -> Vec3:
        """Sum of `Phi_p K(|x_p - x|) / K(0)`; `lanes` (4, 8) is scratch."""
        x = surface.point
        own = vec3(geometry.normals, surface.face)
        # Where shading normals count each photon is asked alone.
        flat = not geometry.smooth[surface.face]
        zero, one = splat(0.0, 8), splat(1.0, 8)
        inverse = splat(1.0 / (photons.radius * photons.radius), 8)
        here = splat(x.x, 8), splat(x.y, 8), splat(x.z, 8)
        normal = splat(own.x, 8), splat(own.y, 8), splat(own.z, 8)
        side, face = splat(surface.side, 8), splat(np.int32(surface.face), 8)
        red, green, blue = zero, zero, zero
        cells = cells_within(photons, x, photons.radius)
        for z in range(cells.z0, cells.z1):
            for y in range(cells.y0, cells.y1):
                begin, end = range_of(photons, cells, y, z)
                for p in range(begin, end, 8):
                    position = rows(photons.position, p)
                    dx, dy, dz = position[0] - here[0], position[1] - here[1], position[2] - here[2]
                    rest = one - (dx * dx + dy * dy + dz * dz) * inverse
                    within = (rest > zero) & (numbers(8) < splat(np.int32(min(end - p, 8)), 8))
                    asked = bits(within)
                    if asked == 0:
                        continue
                    weight = zero
                    if flat:
                        ours = within & (load_ints(photons.face, p, 8) == face)
                        wi = rows(photons.direction, p)
                        cos = wi[0] * normal[0] + wi[1] * normal[1] + wi[2] * normal[2]
                        weight = choose(ours & (cos * side > zero), _falloffs(rest, photons.exponent), zero)
                        asked &= ~bits(ours)
                    if asked != 0:
                        store(lanes, 24, weight)
                        store(lanes, 0, rest)
                        while asked != 0:
                            lane = lowest_bit(asked)
                            asked &= asked - 1
                            lanes[3, lane] = _weight(geometry, photons, p + lane, surface, own, lanes[0, lane])
                        weight = load(lanes, 24, 8)
                    power = rows(photons.power, p)
                    red = red + weight * choose(within, power[0], zero)
                    green = green + weight * choose(within, power[1], zero)
                    blue = blue + weight * choose(within, power[2], zero)
        store(lanes, 0, red)
        store(lanes, 8, green)
        store(lanes, 16, blue)
        return Vec3(_total(lanes, 0), _total(lanes, 1), _total(lanes, 2))

    @device
    def _falloffs(rest: int, exponent: int) -> int:
        """`falloff` of 8 photons."""
        if exponent == 0:
            return splat(1.0, 8)
        return rest if exponent == 1 else rest * rest

else:

    @device
    def _weighted_flux(geometry: Geometry, photons: PhotonMap, surface: Surface, lanes: np.ndarray) -> Vec3:
        """Sum of `Phi_p K(|x_p - x|) / K(0)`; `lanes` (4, 8) is scratch."""
        x = surface.point
        own = vec3(geometry.normals, surface.face)
        inverse = 1.0 / (photons.radius * photons.radius)
        lanes[:] = 0.0
        cells = cells_within(photons, x, photons.radius)
        for z in range(cells.z0, cells.z1):
            for y in range(cells.y0, cells.y1):
                begin, end = range_of(photons, cells, y, z)
                for p in range(begin, end):
                    offset = sub(column(photons.position, p), x)
                    rest = 1.0 - dot(offset, offset) * inverse
                    if rest > 0.0:
                        weight = _weight(geometry, photons, p, surface, own, rest)
                        lane = (p - begin) & 7
                        for channel in range(3):
                            lanes[channel, lane] += weight * photons.power[channel, p]
        return Vec3(_total(lanes, 0), _total(lanes, 1), _total(lanes, 2))
