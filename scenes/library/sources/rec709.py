"""Reflectance spectra as linear Rec. 709 colours under D65.

`X_i = sum(R D65 xbar_i) / sum(D65 ybar)` with the CIE 1931 2 degree observer at 1 nm, then Rec. 709's matrix.
"""

import colour
import numpy as np


def linear_rec709(wavelengths: np.ndarray, reflectance: np.ndarray) -> np.ndarray:
    """Linear Rec. 709 colour of a reflectance spectrum lit by D65; a perfect reflector is (1, 1, 1).

    Parameters
    ----------
    wavelengths : (N,) array, nm, increasing; between them the spectrum is linear, outside it is held.
    reflectance : (N,) array in [0, 1].

    Returns
    -------
    (3,) float64 array.
    """
    grid = colour.SpectralShape(360, 780, 1)
    spectrum = colour.SpectralDistribution(np.interp(grid.wavelengths, wavelengths, reflectance), grid.wavelengths)
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(grid)
    daylight = colour.SDS_ILLUMINANTS["D65"].copy().align(grid)
    xyz = colour.sd_to_XYZ(spectrum, observer, daylight, method="Integration") / 100
    return colour.XYZ_to_RGB(xyz, "ITU-R BT.709")
