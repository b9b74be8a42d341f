"""Allotment: how many times the replicates of a study each side of a row gets, so that few intervals are wide.

A row's mean has the relative variance `v / f + w / g`, v of ours and w of its reference with the replicates that the
study says, f and g the factors on them. The 90 % interval's half width h asks for `v / f + w / g ≤ T`,

    T = (AIM h / t_.95)²,      g ≥ (w + √(v w a / b)) / T,      f ≥ v / (T - w / g).

That g is the cheapest where the study's replicates cost a of ours and b of the reference, by their samples; one that
serves several rows gets the largest of theirs. Where all that is allotted would cost more than WORK times what the
study says, h is widened until it does not.

v and w are a pilot's: a few replicates with random numbers of their own, which no verdict ever sees. What is judged is
therefore independent of how much of it there is, and its tests hold their level as they do with counts that a study
fixes. No clock has a part in it: equal seeds allot equally.
"""

import math
from collections.abc import Hashable, Mapping, Sequence
from typing import NamedTuple

import attrs
import numpy as np

from termwise import reference
from termwise.renderer.terms import Variant
from termwise.reports.statistics import student
from termwise.reports.statistics.replicates import LUMINANCE
from termwise.scenes.limits import Limit
from termwise.scenes.model import Scene

MOST = 16
"""Times the replicates of the study at most: what would take more stays as wide as that leaves it."""
WORK = 4.0
"""Times the cost of the study's own replicates that all rows together may take."""
AIM = 0.85  # of the half width: by 32 replicates a side it is itself known to 9 %
DOF = 62  # of those
PRICE = 8.0
"""Of a reference's sample, one of ours costing 1, roughly: it divides work between the sides and decides no width."""
_STEP = 4  # quarters of the study's replicates
_WIDER = 2.0**0.125


class Noise(NamedTuple):
    """What the two sides of a row vary by.

    Attributes
    ----------
    ours, reference : what names them; rows that name the same share it.
    ours_variance, reference_variance : v and w, (3,) float64, relative.
    ours_cost, reference_cost : a and b.
    """

    ours: Hashable
    reference: Hashable
    ours_variance: np.ndarray
    reference_variance: np.ndarray
    ours_cost: float
    reference_cost: float


def allot(rows: Sequence[Noise], half_width: float) -> tuple[dict[Hashable, float], float]:
    """The factor of each side, quarters from 1 to MOST, and the half width that they are for, in the widest channel."""
    costs = {row.reference: row.reference_cost for row in rows} | {row.ours: row.ours_cost for row in rows}
    while True:
        factors = _factors(rows, half_width)
        if sum(costs[name] * factor for name, factor in factors.items()) <= WORK * sum(costs.values()):
            return factors, half_width
        half_width *= _WIDER


def _factors(rows: Sequence[Noise], half_width: float) -> dict[Hashable, float]:
    total = (AIM * half_width / float(student.isf(0.05, DOF))) ** 2
    factors: dict[Hashable, float] = {}
    for row in rows:
        v, w, price = row.ours_variance, row.reference_variance, row.ours_cost / row.reference_cost
        _raise(factors, row.reference, np.max(w + np.sqrt(v * w * price)) / total)
    for row in rows:
        left = total - row.reference_variance / factors[row.reference]
        needed = np.divide(row.ours_variance, left, out=np.full(3, np.inf), where=left > 0)
        _raise(factors, row.ours, np.max(needed, where=row.ours_variance > 0, initial=0.0))
    return factors


def _raise(factors: dict[Hashable, float], name: Hashable, needed: float) -> None:
    factors[name] = max(factors.get(name, 1.0), math.ceil(_STEP * min(needed, MOST)) / _STEP)


def variance(images: np.ndarray, *, correlated: bool) -> np.ndarray:
    """Variance of a replicate's mean, (3,) float64, from replicates (K, H, W, 3).

    Pixels that are independent tell it from two replicates; those of one photon map are not.
    """
    images = np.asarray(images, np.float64)
    of_pixels = images.var(axis=0, ddof=1).sum((0, 1)) / (images.shape[1] * images.shape[2]) ** 2
    return np.maximum(of_pixels, images.mean(axis=(1, 2)).var(axis=0, ddof=1)) if correlated else of_pixels


def scale(images: np.ndarray) -> np.ndarray:
    """What a bias is relative to, (3,): the channels' means, or a tenth of the luminance where that is more."""
    mean = np.mean(images, axis=(0, 1, 2), dtype=np.float64)
    return np.maximum(mean, 0.1 * np.dot(mean, LUMINANCE))


@attrs.frozen
class Allotment:
    """Factors on the replicates of a study; 1 where nothing is said.

    Attributes
    ----------
    ours : by the names of scene, term and variant.
    reference : by the name of the scene and the limit that is rendered (see `reference.shared`).
    half_width : that they are for; None where nothing is allotted.
    """

    ours: Mapping[tuple[str, str, str], float] = attrs.field(factory=dict)
    reference: Mapping[tuple[str, Limit], float] = attrs.field(factory=dict)
    half_width: float | None = None

    def of(self, scene: Scene, variant: Variant) -> float:
        """Of a variant's replicates."""
        return self.ours.get(key(scene, variant), 1)

    def of_reference(self, scene: Scene, limit: Limit) -> float:
        """Of a limit's replicates."""
        return self.reference.get(reference_key(scene, limit), 1)


def key(scene: Scene, variant: Variant) -> tuple[str, str, str]:
    """What names ours."""
    return scene.name, variant.term, variant.name


def reference_key(scene: Scene, limit: Limit) -> tuple[str, Limit]:
    """What names a reference."""
    return scene.name, reference.shared(scene, limit)
