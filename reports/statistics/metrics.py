"""Distances between two images: RMSE, relative MSE and SSIM.

`RMSE = sqrt(mean (I - R)²)` and `relMSE = mean (I - R)²/(R² + ε)` are taken on linear radiance; SSIM on what a screen
shows: a fixed exposure, clipped to [0, 1], sRGB-encoded, data range 1. The range is fixed because SSIM of one pair of
float images is -0.04, 0.32 or 0.98 for a range of 1, 10 or 100. None of these tells bias from noise (a noisy unbiased
image scores worse than a smooth wrong one): that is the verdict's task.
"""

import numpy as np

from termwise.scenes import srgb

SSIM_WINDOW = 11
"""Side in pixels of the Gaussian window (standard deviation 1.5, cut at 3.5 of them)."""


def rmse(reference: np.ndarray, image: np.ndarray) -> float:
    """Root mean square error over pixels and channels, in the unit of the radiance.

    It holds the noise of both images: its square is `bias² + variance` of each.

    Parameters
    ----------
    reference, image : (..., ) float, equal shapes, linear radiance, finite. Accumulated in float64.

    Raises
    ------
    ValueError : for unequal shapes, no pixels, or a value that is not finite.
    """
    reference, image = _pair(reference, image)
    return float(np.sqrt(np.mean((image - reference) ** 2)))


def relative_mse(reference: np.ndarray, image: np.ndarray, *, epsilon: float | None = None) -> float:
    """Mean of `(I - R)²/(R² + ε)` over pixels and channels, without unit.

    Parameters
    ----------
    reference, image : (..., ) float, equal shapes, linear radiance, finite. Accumulated in float64.
    epsilon : in radiance²; keeps dark pixels from deciding. By default `(mean(R)/10)²`, so that the result does not
        depend on the unit of radiance (a fixed 0.01, the usual choice, hides errors of dim images).

    Raises
    ------
    ValueError : for unequal shapes, no pixels, a value that is not finite, or `ε = 0` (a black reference) while the
        images differ; two black images are 0 apart.
    """
    reference, image = _pair(reference, image)
    if epsilon is None:
        epsilon = float(np.mean(reference) / 10) ** 2
    square = (image - reference) ** 2
    if epsilon == 0 and np.any((reference == 0) & (square > 0)):
        raise ValueError("relative_mse: the reference is black where the image is not; pass epsilon > 0")
    # A difference of 0 is 0 apart whatever it is divided by, 0/0 included.
    return float(np.mean(np.divide(square, reference**2 + epsilon, out=np.zeros_like(square), where=square > 0)))


def ssim(reference: np.ndarray, image: np.ndarray, *, exposure: float) -> float:
    """Structural similarity of the two images as shown: 1 for equal ones, at most 1.

    Wang et al. 2004 with the Gaussian window, mean over pixels and channels, by scikit-image.

    Parameters
    ----------
    reference, image : (H, W, 3) float, H and W ≥ 11, linear Rec. 709 radiance, finite.
    exposure : positive factor on the radiance, fixed per scene: never derived from the images compared.

    Raises
    ------
    ValueError : for unequal or other shapes, a value that is not finite, or an exposure that is not positive.
    """
    from skimage.metrics import structural_similarity  # here: pages without it should not wait for it, nor need it

    reference, image = _pair(reference, image)
    if reference.ndim != 3 or reference.shape[2] != 3 or min(reference.shape[:2]) < SSIM_WINDOW:
        raise ValueError(f"ssim: images are (H, W, 3) with H and W ≥ {SSIM_WINDOW}, not {reference.shape}")
    if not (np.isfinite(exposure) and exposure > 0):
        raise ValueError(f"ssim: exposure is a positive factor, not {exposure}")
    shown = [encode(each, exposure=exposure) for each in (reference, image)]
    similarity = structural_similarity(
        *shown, channel_axis=2, data_range=1.0, gaussian_weights=True, sigma=1.5, use_sample_covariance=False
    )
    return np.asarray(similarity).item()


def encode(radiance: np.ndarray, *, exposure: float, gamma: float | None = None) -> np.ndarray:
    """Values in [0, 1] as a screen shows them: exposed, clipped, encoded by sRGB (IEC 61966-2-1) or v^(1/gamma)."""
    clipped = np.clip(np.asarray(radiance, dtype=np.float64) * exposure, 0.0, 1.0)
    if gamma is not None:
        return clipped ** (1.0 / gamma)
    return srgb.encoded(clipped)


def _pair(reference: np.ndarray, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Both as float64, once they may be compared."""
    pair = np.asarray(reference, dtype=np.float64), np.asarray(image, dtype=np.float64)
    if pair[0].shape != pair[1].shape:
        raise ValueError(f"images of unequal shapes: reference {pair[0].shape}, image {pair[1].shape}")
    if pair[0].size == 0:
        raise ValueError(f"images without pixels: shape {pair[0].shape}")
    for name, values in zip(("reference", "image"), pair, strict=True):
        if not np.all(np.isfinite(values)):
            first = tuple(int(i) for i in np.argwhere(~np.isfinite(values))[0])
            raise ValueError(f"{name}: {values[first]} at index {first}; only finite radiance can be compared")
    return pair
