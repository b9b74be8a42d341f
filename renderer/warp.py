"""Maps of the unit square onto what is sampled, each with its density (`square_to_*`)."""

import math

from renderer.jit import device
from renderer.vector import Vec3

INV_PI = 1.0 / math.pi


@device
def square_to_uniform_sphere(u: float, v: float) -> Vec3:
    """Uniform direction; density 1 / (4 pi)."""
    z = 1.0 - 2.0 * u
    r = math.sqrt(max(0.0, 1.0 - z * z))
    phi = 2.0 * math.pi * v
    return Vec3(r * math.cos(phi), r * math.sin(phi), z)


@device
def hemisphere_ring(mu: float, v: float) -> Vec3:
    """Direction of cosine `mu` and azimuth 2 pi v; with mu uniform the density is 1 / (2 pi)."""
    r = math.sqrt(max(0.0, 1.0 - mu * mu))
    phi = 2.0 * math.pi * v
    return Vec3(r * math.cos(phi), r * math.sin(phi), mu)


@device
def ring_cosine(u: float, rings: int) -> float:
    """Cosine `mu_k = k / (N + 1)` of ring k = 1 .. N, each for an N-th of the unit interval (paper's code).

    Of N Sobol points, N a power of two, each ring gets one. The paper's rule has neither jitter nor the ends of the
    interval: with h the integrand `(1/N) sum h(mu_k) = I + (I - (h(0) + h(1)) / 2) / N + O(N^-2)`, a bias that no
    number of passes removes.
    """
    return (math.floor(u * rings) + 1.0) / (rings + 1.0)


@device
def square_to_cosine_hemisphere(u: float, v: float) -> Vec3:
    """Direction of density cos(theta) / pi, around z.

    Uniform disc by the concentric map (Shirley, Chiu, JGT 2(3), 1997), which keeps stratification,
    lifted to the hemisphere (Malley).
    """
    a = 2.0 * u - 1.0
    b = 2.0 * v - 1.0
    if a == 0.0 and b == 0.0:
        return Vec3(0.0, 0.0, 1.0)
    if abs(a) > abs(b):
        r = a
        phi = 0.25 * math.pi * (b / a)
    else:
        r = b
        phi = 0.5 * math.pi - 0.25 * math.pi * (a / b)
    return Vec3(r * math.cos(phi), r * math.sin(phi), math.sqrt(max(0.0, 1.0 - r * r)))


@device
def square_to_cosine_hemisphere_pdf(cos_theta: float) -> float:
    """Density of the above per solid angle."""
    return max(0.0, cos_theta) * INV_PI


@device
def square_to_triangle(u: float, v: float) -> tuple[float, float]:
    """Barycentric coordinates (b1, b2) of a uniform point.

    Heitz, "A Low-Distortion Map Between Triangle and Square", 2019: two low-distortion halves, which keep the
    stratification of the square.
    """
    if v > u:
        u *= 0.5
        v -= u
    else:
        v *= 0.5
        u -= v
    return u, v
