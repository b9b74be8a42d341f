"""The manual: `make docs` builds it without network, and any warning is an error."""

import sys
from pathlib import Path

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxTranslator

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

project = "Termwise"
author = "Termwise contributors"
project_copyright = author
extensions = ["myst_parser", "sphinx.ext.autodoc", "numpydoc"]
exclude_patterns = ["_build"]

myst_enable_extensions = ["dollarmath"]
myst_fence_as_directive = ["math"]  # as the same page is read where it is not built
myst_heading_anchors = 3

autodoc_typehints = "none"  # numpydoc has the types beside the descriptions
numpydoc_show_class_members = False

html_theme = "furo"
html_title = "Termwise"
html_static_path = ["_static"]
html_css_files = ["manual.css"]
html_show_sphinx = False
html_math_renderer = "mathml"


def _inline(self: SphinxTranslator, node: nodes.math) -> None:
    self.body.append(convert(node.astext(), display="inline"))
    raise nodes.SkipNode


def _block(self: SphinxTranslator, node: nodes.math_block) -> None:
    self.body.append(f'<div class="math">{convert(node.astext(), display="block")}</div>')
    raise nodes.SkipNode


def setup(app: Sphinx) -> None:
    """Equations are MathML, which browsers draw themselves: no script, no font, no picture."""
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
