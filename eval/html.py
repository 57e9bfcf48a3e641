"""The template engine of the HTML pages, which escapes all text that is put into a page."""

import jinja2


def templates() -> jinja2.Environment:
    """A new Jinja environment with the templates of eval/templates; a name without a value is an error."""
    return jinja2.Environment(
        loader=jinja2.PackageLoader("huesphere.eval", "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
