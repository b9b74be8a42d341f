"""The summands of L_o: one file each, its variants in one table; the first of each table is the default.

But of direct, whose default is `auto`: the one of its variants that `renderer.auto` takes in a scene.
"""

import importlib
import re
from collections.abc import Callable
from typing import Literal

from termwise.renderer.terms.estimator import Called, Compiled, Function
from termwise.renderer.terms.variant import Chain, Variant
from termwise.scenes.limits import Limit
from termwise.scenes.model import Scene
from termwise.scenes.terms import TERMS, Term

VARIANTS: dict[Term, dict[str, Variant]] = {
    term: {variant.name: variant for variant in importlib.import_module(f"{__name__}.{term}").VARIANTS}
    for term in TERMS
}
AUTO = "auto"
"""What names the better of direct's right variants in a scene."""
DEFAULTS: dict[Term, str] = {term: next(iter(VARIANTS[term])) for term in TERMS}

__all__ = [
    "AUTO", "DEFAULTS", "VARIANTS", "Chain", "Variant", "find", "named", "names", "register", "registered",
]  # fmt: skip


def find(term: str, name: str | None = None) -> Variant:
    """The variant `name` of a term, the first of its table without a name; a ValueError lists those that exist."""
    _known(term)
    name = DEFAULTS[term] if name is None else name
    if name not in VARIANTS[term]:
        raise ValueError(f"variant = {name!r} of {term}: allowed are {', '.join(VARIANTS[term])}")
    return VARIANTS[term][name]


def names(term: str) -> tuple[str, ...]:
    """What a variant of a term can be named by, the default first."""
    _known(term)
    return (AUTO, *VARIANTS[term]) if term == "direct" else tuple(VARIANTS[term])


def named(term: str, name: str | None = None) -> str:
    """One of the `names`, the default without one; a ValueError lists those that exist."""
    allowed = names(term)
    name = allowed[0] if name is None else name
    if name not in allowed:
        raise ValueError(f"variant = {name!r} of {term}: allowed are {', '.join(allowed)}")
    return name


def _known(term: str) -> None:
    if term not in VARIANTS:
        raise ValueError(f"term = {term!r}: allowed are {', '.join(TERMS)}")


def register(
    term: Term,
    name: str,
    function: Function,
    limit: Limit | Callable[[Scene], Limit],
    *,
    kind: Literal["right", "wrong"] = "right",
    source: str = "",
    identity: str | None = None,
) -> Variant:
    """Add an estimator in Python to a term's table: a study then measures and judges it like any other.

    Parameters
    ----------
    term : one of `scenes.terms.TERMS`.
    name : lower-case words joined by hyphens; not `auto`, nor one that the table has.
    function : (scene, samples, seed) -> image (H, W, 3), linear radiance of that term, its weights inside. Equal seeds
        give equal images, different ones independent images.
    limit : the integral that it is meant to converge to.
    kind : "wrong" where it is not meant to be the term's true integral.
    source : where it comes from.
    identity : what its images depend on beside its arguments; another text, other images. By default its code and all
        that this reaches decide whether images that are kept are its own (see `renderer.fingerprint`); where that
        cannot be told, or it reads files, say it here, or nothing is kept from one run to the next.

    Raises
    ------
    ValueError : an unknown term, a name that exists or has other characters, a limit of another term.
    """
    table = VARIANTS[find(term).term]
    if name in (AUTO, *table):
        raise ValueError(f"register: name = {name!r} of {term}: exists; taken are {', '.join(names(term))}")
    if not re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)*", name):
        raise ValueError(f"register: name = {name!r}: allowed are lower-case words joined by hyphens")
    if isinstance(limit, Limit) and limit.term != term:
        raise ValueError(f"register: limit.term = {limit.term!r}: allowed is {term!r}")
    given = limit
    variant = Variant(
        name=name,
        term=term,
        estimator=Called(function, identity),
        limit=lambda scene, samples: given if isinstance(given, Limit) else given(scene),
        kind=kind,
        equation=rf"\text{{{name}}}(N)",
        converges_to=r"\text{its limit}",
        source=source or f"registered: {getattr(function, '__qualname__', 'a function')}",
    )
    table[name] = variant
    return variant


def registered(term: Term) -> tuple[str, ...]:
    """Names of the estimators of a term that were added by `register`."""
    return tuple(name for name, variant in VARIANTS[term].items() if not isinstance(variant.estimator, Compiled))
