"""Whether an estimator is biased, by how much, where, and how sure that is.

`load` a scene, `render` one of its terms with our renderer, render its `reference` with Mitsuba, and `judge` any
replicate images against any reference. `register` an estimator of your own, with the `Limit` that it is meant to have.
"""

from reference import render as reference
from renderer import render
from renderer.terms import register
from reports.verdict import judge
from scenes.limits import Limit
from scenes.load import load

__all__ = ["Limit", "judge", "load", "reference", "register", "render"]
