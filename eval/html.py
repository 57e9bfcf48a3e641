"""The templates of the pages, with everything printed through them escaped."""

import jinja2


def templates() -> jinja2.Environment:
    """A new environment over eval/templates: a name that is not given is an error, not an empty place."""
    return jinja2.Environment(
        loader=jinja2.PackageLoader("huesphere.eval", "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
