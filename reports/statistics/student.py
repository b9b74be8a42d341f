"""Student's t, `P(t_ν > x)` and its inverse: bit for bit those of `scipy.stats`, which takes a second to import.

SciPy loads its own parts when they are first used, so that importing this costs none of them.
"""

import numpy as np
import scipy


def sf(t: np.ndarray | float, dof: np.ndarray | float) -> np.ndarray:
    """Chance that Student's t is above `t`."""
    return scipy.special.stdtr(dof, -t)


def isf(level: np.ndarray | float, dof: np.ndarray | float) -> np.ndarray:
    """What Student's t is above with a chance of `level`, which is neither 0 nor 1."""
    return 0.0 - scipy.special.stdtrit(dof, level)
