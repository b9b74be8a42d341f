"""Rays that leave a surface and the side that it shows, as the scene's `ignore` and `normals` have them.

By default a ray meets whatever Mitsuba's does, and a surface is shaded from the viewer's side, as `twosided` does. With
`ignore = "object"` a ray flies on through the faces of the object that it leaves; with `normals = "face"` a surface is
shaded about its own normal, from whichever side it is seen. No integrator of Mitsuba's has either.
"""

from typing import Any

import drjit as dr
import mitsuba as mi

OWN_FACES = 64  # of the object that a ray leaves, that it may cross


def plain(loaded: Any) -> bool:
    """Whether both settings are those of Mitsuba's own integrators."""
    return loaded.description["ignore"] == "face" and loaded.description["normals"] == "viewer"


def side(loaded: Any, si: Any) -> Any:
    """+1 or -1: the sign of the shading frame's z that is lit."""
    one = mi.Float(1.0)
    return one if loaded.description["normals"] == "face" else dr.mulsign(one, si.wi.z)


def leave(loaded: Any, scene: Any, si: Any, ray: Any, active: Any) -> tuple[Any, Any]:
    """What a ray from `si`, a point of this very scene, meets; and the ray from behind the last face that it passes."""
    met = scene.ray_intersect(ray, active)
    return (ray, met) if loaded.description["ignore"] == "face" else _through(scene, si.shape, ray, met, active)


def blocked(loaded: Any, scene: Any, si: Any, ray: Any, active: Any) -> Any:
    """Whether anything lies on a ray from `si`, a point of this very scene, that ends at `ray.maxt`."""
    if loaded.description["ignore"] == "face":
        return scene.ray_test(ray, active)
    _, met = _through(scene, si.shape, ray, scene.ray_intersect(ray, active), active)
    return met.is_valid()


@dr.syntax
def _through(scene: Any, own: Any, ray: Any, met: Any, active: Any) -> tuple[Any, Any]:
    ray, met = mi.Ray3f(ray), mi.SurfaceInteraction3f(met)
    inside = active & met.is_valid() & (met.shape == own)
    crossed = mi.UInt32(0)
    while inside:
        reach = ray.maxt - met.t
        ray = met.spawn_ray(ray.d)
        ray.maxt = reach
        met = scene.ray_intersect(ray, inside)
        crossed += 1
        inside &= met.is_valid() & (met.shape == own) & (crossed < OWN_FACES)
    return ray, met
