"""What arrives from a point at distance d: `E / pi = s cos(theta) / d²` times what it radiates."""

import math

from termwise.renderer.jit import device
from termwise.renderer.vector import Vec3, dot, scale


@device
def arriving(normal: Vec3, direction: Vec3, radiant: Vec3, strength: float) -> Vec3:
    """E / pi of `radiant` times `strength` at a surface, from the end of `direction`; black from below."""
    # `direction` is not normalised: each cosine carries one factor of the distance.
    cos_surface = dot(normal, direction)
    if cos_surface <= 0.0:
        return Vec3(0.0, 0.0, 0.0)
    square = dot(direction, direction)
    strength *= cos_surface / (square * math.sqrt(square))
    return scale(radiant, strength)
