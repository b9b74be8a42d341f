"""The kernels as plain Python, a sample of a pixel at a time, with a record of what their functions are given and give.

Nothing of an estimator is written here again: the very functions that Numba compiles run uncompiled, and those of
WATCHED are wrapped in every module that names them. Directions, weights and decisions are their arguments, results and
local variables; the densities alone are evaluated beside them.

A process of its own, `NUMBA_DISABLE_JIT=1 python -m renderer.recorder`, because functions are plain for a whole process
or not at all. It reads pickled requests from standard input and writes pickled answers to standard output:
`(scene arrays, term, variant)` once, then `(inputs or None, key, x, y, sample, split)` -> `(events, radiance)`; inputs
of None are those before. Its parent is `renderer.replay`.
"""

import functools
import inspect
import math
import pickle
import signal
import sys
from collections.abc import Callable
from types import FrameType, SimpleNamespace
from typing import Any

import numpy as np

from termwise.renderer import (
    camera,
    dielectric,
    film,
    kernel_mass,
    lights,
    material,
    photon_density,
    photon_search,
    sobol,
    surface,
)
from termwise.renderer.arrays import SceneArrays
from termwise.renderer.film import Work
from termwise.renderer.jit import PACKAGE
from termwise.renderer.microfacet import pdf_lobe
from termwise.renderer.scratch import new_scratch
from termwise.renderer.terms import VARIANTS, ambient, direct, specular
from termwise.renderer.terms.estimator import Compiled
from termwise.renderer.vector import column

Event = dict[str, Any]

_UNIFORM = 1.0 / (2.0 * math.pi)


class Recorder:
    """Events of a sample, in the order in which they happen.

    A handler is called after the function of its name with the arguments, the result and the caller's frame.
    """

    def __init__(self, scene: SceneArrays) -> None:
        self.scene = scene
        self.events: list[Event] = []
        self._emitter, self._probability = 0, 1.0  # the light that was picked, and how likely it was
        self._gathered: list[Event] = []
        self._mass: float | None = None
        self._found = 0

    def note(self, event: str, **values: Any) -> None:
        """Add an event."""
        self.events.append({"event": event} | {name: _plain(value) for name, value in values.items()})

    def direction_through(self, given: Any, direction: Any, caller: FrameType) -> None:
        """The ray through the pixel."""
        self.note("camera ray", position=given.camera.position, direction=direction)

    def _surface(self, given: Any, found: Any, caller: FrameType) -> None:
        """What a ray meets."""
        if found.face < 0:
            self.note("miss", direction=given.direction)
            return
        first = int(self.scene.geometry.first[found.object])
        triangle = found.face - first
        values = {"position": found.point, "normal": found.normal, "object": found.object, "triangle": triangle}
        before = len(self.events)
        self.note("vertex", **values)
        # A kernel may take the same vertex from its wave of rays a second time.
        if self.events[-1] in self.events[:before]:
            self.events.pop()

    def shadowed(self, given: Any, dark: bool, caller: FrameType) -> None:
        """The paper's shadow rule."""
        if self.scene.shadow_rule is not None and len(self.scene.shadow_rule.object):
            self.note("shadow rule", dark=bool(dark))

    def sample_hemisphere(self, given: Any, drawn: Any, caller: FrameType) -> None:
        """A direction of ambient light, by the rule of the variant."""
        local, weight = drawn
        pdf = {ambient.COSINE: local.z / math.pi, ambient.PAPER_LOOP: None}.get(given.rule, _UNIFORM)
        self.note("ambient direction", local=local, pdf=pdf, weight=weight)

    def sky_light(self, given: Any, drawn: Any, caller: FrameType) -> None:
        """A direction of ambient light that is the sky's; the weight is that of `L_sky cos / pi`."""
        direction, weight = drawn
        self.note("ambient direction", direction=direction, weight=weight)

    def ambient_light(self, given: Any, found: Any, caller: FrameType) -> None:
        """The radiance of a surface that nothing hides."""
        self.note("ambient light", unhidden=found[0])

    def occluded(self, given: Any, hidden: bool, caller: FrameType) -> None:
        """One occlusion ray."""
        self.note("occlusion ray", direction=given.direction, hidden=bool(hidden))

    def occlude_wave(self, given: Any, none: None, caller: FrameType) -> None:
        """The occlusion ray of the one sample in the wave."""
        for i in range(given.count):
            hidden = bool(given.wave.found[i])
            self.note("occlusion ray", direction=column(given.wave.directions, i), hidden=hidden)

    def left_beyond(self, given: Any, left: Any, caller: FrameType) -> None:
        """What is left of light on a ray that goes through glass, or meets what hides it."""
        self.note("goes through", left=left)

    def pick(self, given: Any, picked: Any, caller: FrameType) -> None:
        """Which light."""
        self._emitter, self._probability, _ = picked

    def pick_by_light(self, given: Any, picked: Any, caller: FrameType) -> None:
        """Which light, chosen by what each may send."""
        self._emitter, self._probability, _ = picked

    def sample_light(self, given: Any, sampled: Any, caller: FrameType) -> None:
        """A point of a light: `pdf` per solid angle, None for a light that has one direction."""
        irradiance, direction, target = sampled
        emitters, emitter, probability = self.scene.emitters, self._emitter, self._probability
        self._emitter, self._probability = 0, 1.0
        if len(emitters.kind) == 0:
            return
        pdf = None
        if probability > 0.0:
            kind, row = lights.KINDS[emitters.kind[emitter]], emitters.row[emitter]
            pdf = kind.density(self.scene, row, given.surface, direction, target)
        pdf = None if pdf is None else probability * pdf
        self.note("light", way=direction, probability=probability, pdf=pdf, unhidden=irradiance)

    def gain(self, given: Any, radiance: Any, caller: FrameType) -> None:
        """Light that arrives at a vertex of a diffuse path."""
        self.note("gain", throughput=given.throughput, irradiance=given.irradiance)

    def scattered(self, given: Any, local: Any, caller: FrameType) -> None:
        """Where a diffuse path goes on; below the surface where its light crosses it."""
        through = 0.0 if given.translucency is None else given.translucency[given.surface.object]
        share = through if local.z < 0.0 else 1.0 - through
        if caller.f_code.co_name in ("direct_path", "_bounce"):
            self.note("diffuse direction", local=local, pdf=share * abs(local.z) / math.pi)

    def side_of(self, given: Any, chosen: Any, caller: FrameType) -> None:
        """Whether a sample of ambient light is of the other side."""
        if caller.f_code.co_name != "scattered" and given.share > 0.0:
            self.note("side", translucency=given.share, crosses=bool(chosen[0]))

    def sample_variant(self, given: Any, drawn: Any, caller: FrameType) -> None:
        """A direction of the specular lobe, and its weight before gloss."""
        wi, weight = drawn
        pdf: float | None = _UNIFORM
        if given.lobe == specular.VNDF and given.wo.z > 0.0:
            pdf = pdf_lobe(wi, given.wo, given.alpha)
        elif given.lobe in (specular.PAPER_CODE, specular.PAPER_CODE_NO_PI):
            pdf = None
        self.note("lobe direction", wo=given.wo, local=wi, pdf=pdf, weight=weight)

    def sample_interface(self, given: Any, drawn: Any, caller: FrameType) -> None:
        """A direction of the lobes of a dielectric, its weight with gloss, transparency and tint, and the spread."""
        wi, weight, spread = drawn
        pdf = dielectric.pdf_interface(given.way, given.interface, wi, given.wo)
        self._interface(given, wi, pdf, weight, spread)

    def sample_uniformly(self, given: Any, drawn: Any, caller: FrameType) -> None:
        """The same by the variant `uniform`."""
        wi, weight, spread = drawn
        self._interface(given, wi, _UNIFORM if given.way != dielectric.EITHER else 0.5 * _UNIFORM, weight, spread)

    def _interface(self, given: Any, wi: Any, pdf: float, weight: Any, spread: float) -> None:
        values = {"eta": given.interface.eta, "crosses": bool(wi.z < 0.0), "weight": weight, "spread": spread}
        self.note("lobe direction", wo=given.wo, local=wi, pdf=pdf, **values)

    def survives(self, given: Any, on: bool, caller: FrameType) -> None:
        """Roulette of a diffuse path."""
        self.note("roulette", survival=given.survival, u=given.u, survives=bool(on))

    def sample_1d(self, given: Any, u: float, caller: FrameType) -> None:
        """Roulette of a chain: it reads a number of its own dimension once `survival` is known."""
        if caller.f_code.co_name == "chain" and given.dimension == specular.ROULETTE:
            survival = caller.f_locals["survival"]
            self.note("roulette", survival=survival, u=u, survives=bool(u < survival))

    def falloff(self, given: Any, weight: float, caller: FrameType) -> None:
        """A photon within the kernel."""
        if caller.f_code.co_name == "_weight":
            photon, photons = caller.f_locals["p"], caller.f_locals["photons"]
            distance = photons.radius * math.sqrt(1.0 - given.rest)
            power = column(photons.power, photon)
            self._gathered.append({"photon": photon, "distance": distance, "weight": weight, "flux": _plain(power)})

    def kernel_mass(self, given: Any, mass: float, caller: FrameType) -> None:
        """What the kernel's integral over the surface is."""
        self._mass = mass

    def estimate_irradiance(self, given: Any, irradiance: Any, caller: FrameType) -> None:
        """E by the photons within a radius."""
        if len(given.photons.face):
            self._photons(given.photons.radius, irradiance, mass=self._mass)

    def _sift_up(self, given: Any, none: None, caller: FrameType) -> None:
        """A photon among the nearest, while they are fewer than k."""
        self._found = given.i + 1

    def nearest_irradiance(self, given: Any, irradiance: Any, caller: FrameType) -> None:
        """E by the k nearest photons."""
        nearest = sorted(zip(given.heap[: self._found], given.chosen[: self._found], strict=True))
        self._gathered = [
            {"photon": int(photon), "distance": math.sqrt(square), "flux": _plain(column(given.photons.power, photon))}
            for square, photon in nearest
        ]
        radius = self._gathered[-1]["distance"] if nearest else 0.0
        self._photons(radius, irradiance)

    def _photons(self, radius: float, irradiance: Any, **values: Any) -> None:
        flux = np.sum([photon["flux"] for photon in self._gathered], axis=0) if self._gathered else np.zeros(3)
        count, gathered = len(self._gathered), self._gathered
        self.note("photons", radius=radius, count=count, flux=flux, **values, irradiance=irradiance)
        self.events[-1]["gathered"] = gathered
        self._gathered, self._mass, self._found = [], None, 0

    def added(self, given: Any, total: Any, caller: FrameType) -> None:
        """What is added to a sum of the pixel's samples."""
        self.note("adds", radiance=given.radiance)

    def accumulate(self, given: Any, none: None, caller: FrameType) -> None:
        """What is added to the pixel."""
        throughput = caller.f_locals.get("throughput")
        self.note("adds", **({} if throughput is None else {"throughput": throughput}), radiance=given.radiance)


WATCHED: tuple[Callable[..., Any], ...] = (
    camera.direction_through,
    film.accumulate,
    film.added,
    surface._surface,
    surface.shadowed,
    surface.occluded,
    surface.occlude_wave,
    surface.left_beyond,
    ambient.sample_hemisphere,
    ambient.sky_light,
    ambient.ambient_light,
    lights.pick,
    lights.pick_by_light,
    lights.sample_light,
    direct.gain,
    direct.survives,
    material.scattered,
    material.side_of,
    specular.sample_variant,
    dielectric.sample_interface,
    dielectric.sample_uniformly,
    sobol.sample_1d,
    kernel_mass.falloff,
    kernel_mass.kernel_mass,
    photon_density.estimate_irradiance,
    photon_search._sift_up,
    photon_search.nearest_irradiance,
)
"""Functions whose calls are recorded, by the method of Recorder that has their name."""


def _plain(value: Any) -> Any:
    """Numbers, and lists of them."""
    if isinstance(value, tuple | np.ndarray):
        return [_plain(item) for item in value]
    return value.item() if isinstance(value, np.generic) else value


def _watch(recorder: Recorder) -> None:
    """Put a wrapper in the place of every watched function, wherever a module of `renderer` names it."""
    wrapped = {function: _wrapped(function, getattr(recorder, function.__name__)) for function in WATCHED}
    for name, module in list(sys.modules.items()):
        if name.startswith(PACKAGE) and module is not sys.modules[__name__]:
            for attribute, value in list(vars(module).items()):
                if inspect.isfunction(value) and value in wrapped:
                    setattr(module, attribute, wrapped[value])


def _wrapped(function: Callable[..., Any], handler: Callable[..., None]) -> Callable[..., Any]:
    signature = inspect.signature(function)

    @functools.wraps(function)
    def call(*arguments: Any) -> Any:
        result = function(*arguments)
        handler(SimpleNamespace(**signature.bind(*arguments).arguments), result, sys._getframe(1))
        return result

    return call


def main() -> None:
    """Answer requests until there are no more; what is typed to interrupt the parent is the parent's affair."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    requests, answers = sys.stdin.buffer, sys.stdout.buffer
    scene, term, name = pickle.load(requests)
    recorder = Recorder(scene)
    _watch(recorder)
    estimator, scratch = VARIANTS[term][name].estimator, new_scratch()
    assert isinstance(estimator, Compiled)
    inputs: tuple[Any, ...] = ()
    while True:
        try:
            given, key, x, y, sample, split = pickle.load(requests)
        except EOFError:
            return
        inputs = inputs if given is None else given
        recorder.events = []
        out = np.zeros((scene.camera.height, scene.camera.width, 3))
        begin, end = np.zeros((2, *out.shape[:2]), np.int32)
        begin[y, x], end[y, x] = sample, sample + 1
        work = Work(np.array([[x, y, x + 1, y + 1, split]]), begin, end, np.zeros(1, np.int64), 1)
        estimator.driver(scene, *inputs, key, work, out, scratch)
        pickle.dump((recorder.events, out[y, x]), answers)
        answers.flush()


if __name__ == "__main__":
    main()
