"""The documentation's site: Markdown by MyST, equations as MathML, nothing fetched from a network. `make docs`."""

from latex2mathml.converter import convert

project = "huesphere"
author = "The huesphere authors"
copyright = "the huesphere authors, BSD-3-Clause"
extensions = ["myst_parser"]
myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 3
html_theme = "furo"
html_title = "huesphere"
html_math_renderer = "mathml"
html_copy_source = False
html_static_path = ["_static"]
html_css_files = ["site.css"]
exclude_patterns = ["_build", "notebooks/*.ipynb"]
suppress_warnings = ["myst.header"]  # pages of studies begin at any level


def _inline(translator, node):
    translator.body.append(convert(node.astext()))
    raise _skip()


def _block(translator, node):
    translator.body.append(f'<div class="math">{convert(node.astext(), display="block")}</div>\n')
    raise _skip()


def _skip():
    from docutils.nodes import SkipNode

    return SkipNode()


def setup(app):
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
