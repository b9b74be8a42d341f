"""Mitsuba's side of `terms`: each integral through `mi.render`, in every setting that might be its best.

A setting is a sampler and an integrator:

- ambient: n occlusion rays (`ray_test`), drawn by the cosine, share a camera ray's hit. Mitsuba has no such integrator
  for a finite range, and its `direct` asks for the nearest hit where any will do.
- direct, `first-hit`: `direct` with n emitter samples a camera ray and none of the BSDF.
- direct, `all`: `path` in the Lambertian twin, of any length, its roulette from the eighth vertex on or from Mitsuba's.
- specular, transmission: the reference's chain, its diffuse terms estimated at one vertex, with n occlusion rays there.

Seconds are those of the kernels, by Dr.Jit's own history: `mi.render` traces its program anew at each call, and
compiles it at the first; a frozen function (`dr.freeze`) would not. Both are kept apart. Kernels took the wall-clock
time of a frozen call within 10 % (4 to 64 samples a pixel).
Import this module after `reference.backend.import_mitsuba`.
"""

# pyright: reportArgumentType=false, reportCallIssue=false, reportAttributeAccessIssue=false, reportOperatorIssue=false
# Mitsuba's stubs do not know the types of the variant in use.

import time
from collections.abc import Iterator
from typing import Any

import attrs
import drjit as dr
import mitsuba as mi
import numpy as np

from termwise.reference import paths
from termwise.reference.film import sensor
from termwise.reference.terms import specular
from termwise.reference.wavefront import UNBOUNDED, Samples
from termwise.scenes.limits import Limit

SAMPLERS = ("independent", "multijitter", "orthogonal", "ldsampler")
# Rays that share a camera ray: a hit found anew costs less than a sixteenth of what 16 do.
SHARED = (1, 4, 16)
# Occlusion rays at the one vertex of a chain that has them.
OCCLUSION = (1, 4)
# Samples a pixel that are asked for; a sampler rounds them up to what it can spread.
LADDER = tuple(4**power for power in range(9))
# Depth from which roulette may end a path: that of the film's references, or Mitsuba's default.
_ROULETTE = {"": paths.START, "rr": 5}


class Occlusion(mi.SamplingIntegrator):
    """`color (1 - g) L_a0 (1/n) Σ hit(w_k)`, w_k ~ cosine: n occlusion rays from the hit of one camera ray."""

    def __init__(self, rays: int, reach: float, color: list[float]) -> None:
        """Take n, the range (infinite from `UNBOUNDED`) and L_a0."""
        mi.SamplingIntegrator.__init__(self, mi.Properties())
        self._rays, self._reach, self._color = rays, reach, mi.Color3f(color)

    def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True) -> Any:
        """Radiance along a camera ray."""
        si = scene.ray_intersect(ray, mi.RayFlags.All, True, active)
        active &= si.is_valid()
        albedo = si.bsdf().eval_diffuse_reflectance(si, active)
        side = dr.mulsign(mi.Float(1.0), si.wi.z)
        seen = mi.Float(0.0)
        for _ in range(self._rays):
            local = mi.warp.square_to_cosine_hemisphere(sampler.next_2d(active))
            shadow = si.spawn_ray(si.to_world(side * local))
            if self._reach < UNBOUNDED:
                shadow.maxt = self._reach
            seen += dr.select(scene.ray_test(shadow, active), 0.0, 1.0)
        return dr.select(active, albedo * self._color * (seen / self._rays), 0.0), active, []


class Chain(mi.SamplingIntegrator):
    """The reference's estimator of a chain, the vertex of its diffuse terms chosen by the sampler."""

    def __init__(self, loaded: Any, limit: Limit, rays: int) -> None:
        """Take the scene of all roles, the integral, and how many occlusion rays a chain has."""
        mi.SamplingIntegrator.__init__(self, mi.Properties())
        self._estimate = specular.estimator(loaded, attrs.asdict(limit), occlusion_rays=rays)

    def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True) -> Any:
        """Radiance along a camera ray."""
        # Stratified, where the sampler is.
        (color,) = self._estimate(Samples(mi.Ray3f(ray), sampler, sampler.next_2d(), sampler.next_1d()))
        return color, mi.Bool(True), []


class Setting:
    """A sampler with an integrator, ready to render at any count of samples.

    Attributes
    ----------
    name : what a table calls it.
    ladder : counts of samples of its pilot run; None before it.
    overhead : wall-clock seconds that a call takes beyond its kernels, median of all calls so far: it traces its
        program anew.
    compile_seconds : the same of the first call, discarded otherwise: it compiles, or finds kernels on the disk. Those
        of other counts have the same kernels, but where samples are too many for one.
    """

    def __init__(self, name: str, sampler: str, scene: Any, integrator: Any, camera: dict[str, Any]) -> None:
        """Bind a scene; `camera` is the one of its description."""
        self.name, self._scene, self._integrator = (f"{sampler} {name}".strip(), scene, integrator)
        self._sensor = sensor(camera, 1, sampler)
        self._counts = mi.load_dict({"type": sampler})
        self._compiled = False
        self._overheads: list[float] = []
        self.ladder: tuple[int, ...] | None = None
        self.compile_seconds = 0.0

    @property
    def overhead(self) -> float:
        """See the class."""
        return float(np.median(self._overheads)) if self._overheads else 0.0

    def samples(self, asked: int) -> int:
        """Samples a pixel that the sampler makes of `asked`."""
        self._counts.set_sample_count(asked)
        return self._counts.sample_count()

    def render(self, count: int, seed: int) -> tuple[np.ndarray, float]:
        """Image (H, W, 3) float64 of `count` samples a pixel, and the seconds of its kernels."""
        if not self._compiled:
            self._compiled = True
            self.render(count, seed)
            self.compile_seconds = self._overheads.pop()
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            start = time.perf_counter()
            image = np.array(
                mi.render(self._scene, sensor=self._sensor, integrator=self._integrator, spp=count, seed=seed)
            )
            wall = time.perf_counter() - start
            kernels = sum(kernel.get("execution_time") or 0.0 for kernel in dr.kernel_history()) / 1e3
        self._overheads.append(wall - kernels)
        return image[..., :3].astype(np.float64), kernels


def settings(loaded: Any, limit: Limit) -> Iterator[Setting]:
    """All settings of a limit's term.

    Parameters
    ----------
    loaded : the scene of all roles, `reference.loaded`; no camera ray of it may meet a light, which `mi.render` lets
        through.
    limit : of scope `first-hit` or `all` where the term has one.
    """
    mi.set_log_level(mi.LogLevel.Error)  # samplers say that they round
    description = loaded.description
    integrators: dict[str, Any]
    if limit.term == "ambient":
        ambient = description["ambient"]
        role = "ambient"
        integrators = {f"x{n}": Occlusion(n, ambient["range"], ambient["color"]) for n in SHARED}
    elif limit.term in ("specular", "transmission"):
        role = limit.term
        integrators = {f"x{n}": Chain(loaded, limit, n) for n in OCCLUSION}
    elif limit.term != "direct":
        raise ValueError(f"term = {limit.term!r}: allowed are ambient, direct, specular and transmission")
    elif limit.scope == "first-hit":
        role = "direct"
        # Each of n samples of a light that no ray meets counts fully in Mitsuba's `direct`: n times too bright.
        points = any(mi.has_flag(each.flags(), mi.EmitterFlags.Delta) for each in loaded.scenes["direct"].emitters())
        integrators = {
            f"x{n}": mi.load_dict({"type": "direct", "emitter_samples": n, "bsdf_samples": 0, "hide_emitters": True})
            for n in (SHARED[:1] if points else SHARED)
        }
    else:
        role = "direct"
        integrators = {
            name: mi.load_dict({"type": "path", "max_depth": -1, "rr_depth": start, "hide_emitters": True})
            for name, start in _ROULETTE.items()
        }
    for sampler in SAMPLERS:
        for name, integrator in integrators.items():
            yield Setting(name, sampler, loaded.scenes[role], integrator, description["camera"])
