"""The templates of pages."""

from functools import cache
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined, Template

from brink.worker.printable import printable


def _without_controls(value: Any) -> Any:
    return printable(value) if type(value) is str else value  # markup is no plain text


@cache
def page_template(name: str) -> Template:
    """Return the template of a page, which escapes all its values.

    Args:
        name: Its file name.
    """
    environment = Environment(
        loader=PackageLoader("brink.report"),
        autoescape=True,
        finalize=_without_controls,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(name)
