"""Pages as Markdown: names from a store are text and nothing else, and tables are made by the tables' own renderer."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from functools import cache
from typing import Any, TypeVar

from markupsafe import Markup

from bench.reporting.tables.render import Columns, listing, markdown_table

Item = TypeVar("Item")


def escaped(value: object) -> Markup:
    """A value whose signs mean nothing in Markdown or HTML; what is Markdown already stays."""
    if isinstance(value, Markup):
        return value
    return Markup(re.sub(r"[^\w\s.,;:()%/=×–’-]|_", lambda sign: f"&#{ord(sign[0])};", " ".join(str(value).split(" "))))


def link(address: str, name: object) -> Markup:
    """A link to another page of the site, by its address from this one."""
    return Markup(f"[{escaped(name)}]({address})")


def code(text: object) -> Markup:
    """A text in the letters of programs."""
    return Markup(f"<code>{escaped(text)}</code>")


def table(items: Iterable[Item], columns: Columns[Item]) -> Markup:
    """A table with a row an item; nothing where there is none."""

    def cell(show: Callable[[Item], str]) -> Callable[[Item], str]:
        return lambda item: str(escaped(show(item))).replace("\n", " ")

    rows, headers = listing(items, {name: cell(show) for name, show in columns.items()})
    return Markup(f"\n\n{markdown_table(rows, headers)}\n") if rows else Markup("")


def rendered(template: str, **values: Any) -> str:
    """A page of one of the templates beside this module, every value escaped."""
    return str(_templates().get_template(f"{template}.md.j2").render(**values)) + "\n"


@cache
def _templates() -> Any:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    return Environment(
        loader=PackageLoader("bench.reporting.page"), autoescape=True, undefined=StrictUndefined, finalize=escaped,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
