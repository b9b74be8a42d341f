"""The terms of `L_o = L_ambient + L_direct + L_specular (+ L_background)` and the estimate of one.

`total = ((ambient + direct) + specular) + background`, added in this order, bit for bit.
"""

from typing import Literal, get_args

import attrs
import numpy as np

Term = Literal["ambient", "direct", "specular", "background"]
Scope = Literal["first-hit", "all"]

TERMS: tuple[Term, ...] = get_args(Term)
TOTAL = "total"


@attrs.frozen(eq=False)
class TermImage:
    """An estimate of a term's contribution to each pixel, its weight (color, gloss) inside.

    Attributes
    ----------
    mean : (H, W, 3) float64
        Radiance, linear Rec. 709, in the scene's radiance unit; mean over replicates.
    variance : (H, W, 3) float64
        Variance of `mean`, estimated from independent replicates; NaN with a single replicate,
        because low-discrepancy samples inside one replicate are not independent.
    samples : int
        Samples per pixel and replicate.
    replicates : int
        Independent replicates (own seed each, own photon maps) behind `mean`.
    seconds : float
        Wall-clock seconds, compilation excluded.
    """

    mean: np.ndarray
    variance: np.ndarray
    samples: int
    replicates: int
    seconds: float

    @classmethod
    def from_replicates(cls, images: np.ndarray, *, samples: int, seconds: float) -> "TermImage":
        """Mean and variance of the mean of `images` (K, H, W, 3), accumulated in float64."""
        count = len(images)
        mean = np.asarray(np.mean(images, axis=0, dtype=np.float64))
        variance = (
            np.var(images, axis=0, ddof=1, dtype=np.float64) / count
            if count > 1
            else np.full_like(mean, np.nan)
        )
        return cls(mean, variance, samples, count, seconds)


def total(
    ambient: np.ndarray, direct: np.ndarray, specular: np.ndarray, background: np.ndarray
) -> np.ndarray:
    """Sum the four term images in the one order that makes the sum reproducible to the bit."""
    return ((ambient + direct) + specular) + background
