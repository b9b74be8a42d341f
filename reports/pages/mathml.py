r"""LaTeX such as `L_o = L_{ambient} + \dots` as MathML, which needs neither network nor script."""

import re

from latex2mathml.converter import convert
from markupsafe import Markup

# What the converter writes as it should not be set: the relation ~ is no identifier, and a function's name stands
# apart from its argument.
_REPAIRS = (
    (re.compile(r"<mi>(?:&#x0007E;|~)</mi>"), "<mo>&#x0223C;</mo>"),
    (re.compile(r"(</mi>|</msub>|</msup>)(?=<mi>cos</mi>)"), r'\1<mspace width="0.14em" />'),
    (re.compile(r"<mi>(cos|sin|tan|max|min|erf)</mi>"), r'<mi>\1</mi><mspace width="0.14em" />'),
)


def mathml(latex: str, *, block: bool = False) -> Markup:
    """MathML of a LaTeX formula, for a line of its own if `block`; ValueError if it is not understood.

    The formula itself stays as its alternative text.
    """
    latex = str(latex).strip()
    try:
        markup = convert(latex, display="block" if block else "inline")
    except Exception as error:  # the converter has a dozen kinds, without a common base
        raise ValueError(f"equation = {latex!r}: is not LaTeX that can be shown ({type(error).__name__})") from None
    for wrong, right in _REPAIRS:
        markup = wrong.sub(right, markup)
    # What is wider than a narrow screen scrolls, by keys too.
    focus = ' tabindex="0"' if block else ""
    return Markup(markup.replace("<math ", Markup('<math alttext="{}"' + focus + " ").format(latex), 1))
