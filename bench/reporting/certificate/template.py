"""Render HTML pages that load nothing else, from the templates of this folder."""

from __future__ import annotations

from typing import Any


def rendered(name: str, **values: Any) -> str:
    """Return the page of a template, which extends ``base.html.j2`` and uses the macros of ``tables.html.j2``."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    templates = Environment(
        loader=PackageLoader("bench.reporting.certificate", "."), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    return f"{templates.get_template(name).render(values)}\n"
