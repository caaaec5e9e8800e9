"""Render pages in Markdown from templates, with all values escaped."""

from __future__ import annotations

import re
from functools import cache
from typing import Any

from markupsafe import Markup

from bench.reporting import rounding
from bench.reporting.page import home, words


def escaped(value: object) -> Markup:
    """Escape a value for Markdown and HTML, on one line; Markup is returned as it is."""
    if isinstance(value, Markup):
        return value
    text = " ".join(str(value).split("\n"))
    return Markup(re.sub(r"[^\w\s.,;:()%/=×–’-]|_", lambda sign: f"&#{ord(sign[0])};", text))


def link(address: str, name: object) -> Markup:
    """Return a link to another page of the site."""
    return Markup(f"[{escaped(name)}]({address})")


def rendered(template: str, **values: Any) -> str:
    """Render a template of this package, with all values escaped."""
    return str(_templates().get_template(f"{template}.md.j2").render(**values)) + "\n"


@cache
def _templates() -> Any:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    templates = Environment(
        loader=PackageLoader("bench.reporting.page"), autoescape=True, undefined=StrictUndefined, finalize=escaped,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    functions = {**vars(rounding), **vars(home), **vars(words)}
    templates.filters |= {name: function for name, function in functions.items() if callable(function)}
    return templates
