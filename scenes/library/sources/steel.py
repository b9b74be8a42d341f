"""Steel's reflectance at normal incidence, from tabulated n and k of iron: prints `f0` of `two_cubes.toml`.

`F0 = ((n - 1)^2 + k^2) / ((n + 1)^2 + k^2)` per wavelength (Fresnel at normal incidence, from air), then
linear Rec. 709 under D65. Iron stands for steel, which is mostly iron.

n, k: P. B. Johnson and R. W. Christy, "Optical constants of transition metals: Ti, V, Cr, Mn, Fe, Co, Ni, and
Pd", Phys. Rev. B 9, 5056-5070 (1974), as tabulated at refractiveindex.info (main/Fe/Johnson, CC0).
"""

import numpy as np
from rec709 import linear_rec709

# wavelength (nm), n, k: the table's rows from 354 to 821 nm, which cover the visible range.
IRON = np.array(
    [
        (354, 1.93, 2.35),
        (368, 2.02, 2.43),
        (381, 2.12, 2.50),
        (397, 2.24, 2.58),
        (413, 2.35, 2.65),
        (431, 2.48, 2.71),
        (451, 2.59, 2.77),
        (471, 2.67, 2.82),
        (496, 2.74, 2.88),
        (521, 2.86, 2.91),
        (549, 2.95, 2.93),
        (582, 2.94, 2.99),
        (617, 2.88, 3.05),
        (659, 2.92, 3.10),
        (704, 2.86, 3.19),
        (756, 2.87, 3.28),
        (821, 2.94, 3.39),
    ]
)


def normal_reflectance(n: np.ndarray, k: np.ndarray) -> np.ndarray:
    """Fresnel reflectance at normal incidence of a conductor of index n + ik in air."""
    return ((n - 1) ** 2 + k**2) / ((n + 1) ** 2 + k**2)


def steel_f0() -> np.ndarray:
    """F0 of iron, (3,) linear Rec. 709 under D65."""
    wavelengths, n, k = IRON.T
    return linear_rec709(wavelengths, normal_reflectance(n, k))


if __name__ == "__main__":
    print("f0 = [" + ", ".join(f"{x:.4f}" for x in steel_f0()) + "]")
