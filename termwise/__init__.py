"""Whether an estimator is biased, by how much, where, and how sure that is.

`load` a scene, `render` one of its terms with our renderer, render its `reference` with Mitsuba, and `judge` any
replicate images against any reference. `register` an estimator of your own, with the `Limit` that it is meant to have.

Importing this loads nothing else: each name brings what it needs when it is first asked for, so that `judge` costs
neither Numba nor Mitsuba. The folders beside it, `scenes`, `renderer`, `reference` and `reports`, are linked here, so
that all is imported as `termwise.…` and no module of that name beside a user's script stands in the way.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from termwise.reference import render as reference
    from termwise.renderer import render
    from termwise.renderer.terms import register
    from termwise.reports.judging.engines import engine
    from termwise.reports.judging.judge import judge
    from termwise.scenes.limits import Limit
    from termwise.scenes.load import load

__all__ = ["Limit", "engine", "judge", "load", "reference", "register", "render"]

_HOMES = {
    "Limit": "scenes.limits",
    "engine": "reports.judging.engines",
    "judge": "reports.judging.judge",
    "load": "scenes.load",
    "register": "renderer.terms",
    "render": "renderer",
}


_EXTRAS = {
    "numba": "render",
    "nicegui": "render",
    "matplotlib": "render",
    "skimage": "render",
    "xarray": "render",
    "mitsuba": "reference",
    "drjit": "reference",
    "distributed": "cluster",
    "dask": "cluster",
}


def lacking(error: ModuleNotFoundError) -> str:
    """What to install where a package that an extra brings is missing, in one line."""
    extra = _EXTRAS.get(error.name or "")
    return f"{error.name} is not installed" + (f": pip install 'termwise[{extra}]' brings it" if extra else "")


def __getattr__(name: str) -> Any:
    """Import what a public name stands for."""
    if name == "reference":
        # The package itself, which can be called: its name is that of the function it is for.
        return importlib.import_module("termwise.reference")
    if name not in _HOMES:
        raise AttributeError(f"module 'termwise' has no attribute {name!r}")
    try:
        value = getattr(importlib.import_module(f"termwise.{_HOMES[name]}"), name)
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(f"termwise.{name}: {lacking(error)}", name=error.name) from error
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
