"""Transmission: `L_transmission(x) = t tint S_t[L_ambient + L_direct + L_specular + L_transmission + L_sky]`, M deep.

S_t is the integral against what the facets of a dielectric let through (`dielectric`). The chain is that of `specular`:
both lobes at every vertex but the camera's.
"""

from .specular import estimator

__all__ = ["estimator"]
