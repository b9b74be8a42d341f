"""The paper's shadow rule: a point is dark where it sees the centre of no light, the light's own faces apart."""

from typing import Any

import drjit as dr
import mitsuba as mi

from .. import rays
from ..wavefront import shape_pointer

OWN_FACES = 8  # of a light, that a ray to its centre may cross


def rule(loaded: Any, limit: dict[str, Any], role: str) -> Any:
    """(si, active) -> whether the limit's rule makes a point of the role's scene dark; never, where it has none."""
    centres = loaded.description["light_centres"] if limit["shadows"] == "paper" else []
    if not centres:
        return lambda si, active: mi.Bool(False)
    scene = loaded.scenes[role]
    shapes = scene.shapes()

    def hidden(si: Any, active: Any, centre: Any, shape: int, first: int, end: int) -> Any:
        open_lanes, blocked = mi.Bool(active), mi.Bool(False)
        for _ in range(OWN_FACES):
            ray = rays.segment(si, centre, mi.Normal3f(0.0))
            ray.maxt -= 4.0 * rays.LIFT  # what lies in the plane of a light's face does not hide its centre
            _, hit = rays.leave(loaded, scene, si, ray, open_lanes)
            met = open_lanes & hit.is_valid()
            own = mi.Bool(False)
            if shape >= 0:
                own = met & (hit.shape == shape_pointer(shapes[shape]))
                own &= (hit.prim_index >= first) & (hit.prim_index < end)
            blocked |= dr.select(own, False, met)
            open_lanes = own
            si = hit
        return blocked

    def dark(si: Any, active: Any) -> Any:
        all_hidden = mi.Bool(True)
        for centre, *place in centres:
            all_hidden &= hidden(si, active, dr.opaque(mi.Point3f, centre), *place)
        return all_hidden

    return dark
