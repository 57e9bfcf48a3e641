"""The template engine of the HTML pages, which escapes all text that is put into a page."""

from typing import Any

import jinja2
from markupsafe import Markup

from huesphere.configs.visible import visible


def templates() -> jinja2.Environment:
    """A new Jinja environment with the templates of eval/templates; a name without a value is an error."""
    return jinja2.Environment(
        loader=jinja2.PackageLoader("huesphere.eval", "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        finalize=_without_control_characters,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def _without_control_characters(value: Any) -> Any:
    """Text from files with its control characters shown: a page may be printed to a terminal, too."""
    return visible(value) if isinstance(value, str) and not isinstance(value, Markup) else value
