"""Pages as Markdown from templates, in which names from a store are text and nothing else."""

from __future__ import annotations

import re
from functools import cache
from typing import Any

from markupsafe import Markup

from bench.reporting.page import home, words


def escaped(value: object) -> Markup:
    """A value whose signs mean nothing in Markdown or HTML, on one line; what is Markdown already stays."""
    if isinstance(value, Markup):
        return value
    text = " ".join(str(value).split("\n"))
    return Markup(re.sub(r"[^\w\s.,;:()%/=×–’-]|_", lambda sign: f"&#{ord(sign[0])};", text))


def link(address: str, name: object) -> Markup:
    """A link to another page of the site, by its address from this one."""
    return Markup(f"[{escaped(name)}]({address})")


def rendered(template: str, **values: Any) -> str:
    """A page of one of the templates beside this module, every value escaped."""
    return str(_templates().get_template(f"{template}.md.j2").render(**values)) + "\n"


@cache
def _templates() -> Any:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    templates = Environment(
        loader=PackageLoader("bench.reporting.page"), autoescape=True, undefined=StrictUndefined, finalize=escaped,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    functions = {**vars(words), **vars(home)}
    templates.filters |= {name: one for name, one in functions.items() if callable(one)}
    return templates
