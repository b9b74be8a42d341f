"""Whether an estimator is biased, by how much, where, and how sure that is.

`load` a scene, `render` one of its terms with our renderer, render its `reference` with Mitsuba, and `judge` any
replicate images against any reference.
"""

from reference import render as reference
from renderer import render
from reports.verdict import judge
from scenes.load import load

__all__ = ["judge", "load", "reference", "render"]
