"""Light from beyond the scene: a disc in the sky of one radiance, or a point of it, where its half angle is 0.

`E = H cos θ` for the irradiance H on a surface that faces it. A disc is sampled uniformly in its solid angle; the light
of a sample is radiance times that angle, `2 H / (1 + cos a)`. To Mitsuba it is a light of one direction, which no lobe
meets; the direction differs from sample to sample. A shadow ray ends where it leaves the box around the scene: a sky
that is a shape around it hides nothing. Photons begin on a disc whose radius is that of the ball around the box.
"""

# pyright: reportCallIssue=false, reportArgumentType=false, reportOperatorIssue=false, reportAttributeAccessIssue=false
# Mitsuba's stubs do not know the types of the variant in use.

from typing import Any

import drjit as dr
import mitsuba as mi

OUTSIDE = 2.0**-10  # of the box that shadow rays leave, beyond the scene's own
FAR = 1e4  # longer than any way out of the box


class Distant(mi.Emitter):
    """A sun, or a directional light."""

    def __init__(self, props: Any) -> None:
        """Read `towards`, a unit vector, `below`, 1 - cos a, `flux`, the light of a sample, `box`, and `radius`."""
        mi.Emitter.__init__(self, props)
        self._frame = mi.Frame3f(dr.opaque(mi.Vector3f, list(props["towards"])))
        self._below = dr.opaque(mi.Float, props["below"])
        self._flux = dr.opaque(mi.Color3f, list(props["flux"]))
        self._half = dr.opaque(mi.Vector3f, list(props["box"])) + OUTSIDE
        self._radius = dr.opaque(mi.Float, props["radius"])
        self.m_flags = mi.EmitterFlags.Infinite | mi.EmitterFlags.DeltaDirection
        self.m_needs_sample_2 = self.m_needs_sample_3 = True

    def _towards(self, sample: Any) -> Any:
        """A uniform direction towards the disc."""
        below = sample.x * self._below
        radius = dr.safe_sqrt(below * (2.0 - below))
        sine, cosine = dr.sincos(2.0 * dr.pi * sample.y)
        return self._frame.to_world(mi.Vector3f(radius * cosine, radius * sine, 1.0 - below))

    def sample_direction(self, it: Any, sample: Any, active: Any = True) -> Any:
        """Direction to a point of the disc, and its light."""
        way = self._towards(sample)
        out = dr.mulsign(self._half, way) - it.p
        ds = mi.DirectionSample3f()
        ds.dist = dr.min(dr.select(dr.abs(way) * FAR > dr.abs(out), out / way, FAR))
        ds.p, ds.n, ds.d, ds.uv, ds.time = dr.fma(way, ds.dist, it.p), -way, way, sample, it.time
        ds.pdf, ds.delta = dr.select(active, mi.Float(1.0), 0.0), True
        ds.emitter = mi.EmitterPtr(self) if dr.is_jit_v(mi.Float) else self
        return ds, dr.select(active, self._flux, 0.0)

    def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
        """No ray meets it."""
        return mi.Float(0.0)

    def eval(self, si: Any, active: Any = True) -> Any:
        """No ray meets it."""
        return mi.Color3f(0.0)

    def sample_ray(self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True) -> Any:
        """A photon: a ray through a uniform point of the disc across it, with the flux of all."""
        way = -self._towards(sample3)
        across = self._radius * mi.warp.square_to_uniform_disk_concentric(sample2)
        origin = mi.Frame3f(way).to_world(mi.Vector3f(across.x, across.y, -2.0 * self._radius))
        flux = self._flux * dr.pi * dr.square(self._radius)
        return mi.Ray3f(mi.Point3f(origin), way, time, []), dr.select(active, flux, 0.0)

    def bbox(self) -> Any:
        """Nothing: it is not in the scene."""
        return mi.ScalarBoundingBox3f()

    def to_string(self) -> str:
        """Name the plugin."""
        return "Distant[]"


def discs(suns: list[dict[str, Any]]) -> Any:
    """(direction, active) -> mi.Color3f: radiance of the suns that a unit direction points into.

    By the chord between direction and middle: cosines of a narrow disc have no digits in single precision.
    """
    known = [
        (
            dr.opaque(mi.Vector3f, sun["towards"]),
            dr.opaque(mi.Float, sun["chord"]),
            dr.opaque(mi.Color3f, sun["radiance"]),
        )
        for sun in suns
    ]

    def seen(direction: Any, active: Any) -> Any:
        color = mi.Color3f(0.0)
        for towards, chord, radiance in known:
            color += dr.select(active & (dr.norm(direction - towards) <= chord), radiance, 0.0)
        return color

    return seen


def register() -> None:
    """Make `distant_light` known to Mitsuba."""
    mi.register_emitter("distant_light", Distant)
