"""The summands of L_o: one file each, its variants in one table; the first of each table is the default."""

from renderer.terms import ambient, background, direct, specular
from renderer.terms.variant import Chain, Variant
from scenes.terms import TERMS, Term

VARIANTS: dict[Term, dict[str, Variant]] = {
    module.VARIANTS[0].term: {variant.name: variant for variant in module.VARIANTS}
    for module in (ambient, direct, specular, background)
}
DEFAULTS: dict[Term, str] = {term: next(iter(VARIANTS[term])) for term in TERMS}

__all__ = ["DEFAULTS", "VARIANTS", "Chain", "Variant", "find"]


def find(term: str, name: str | None = None) -> Variant:
    """The variant `name` of a term, the default one without a name; a ValueError lists those that exist."""
    if term not in VARIANTS:
        raise ValueError(f"term = {term!r}: allowed are {', '.join(TERMS)}")
    table = VARIANTS[term]
    name = DEFAULTS[term] if name is None else name
    if name not in table:
        raise ValueError(f"variant = {name!r} of {term}: allowed are {', '.join(table)}")
    return table[name]
