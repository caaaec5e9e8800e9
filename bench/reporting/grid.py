"""What pages share: a table of text, their style sheets, and the templates that make them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any


@dataclass(frozen=True)
class Grid:
    """A table: headers, rows of text, and a class for each row."""

    headers: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    classes: tuple[str, ...] = ()


def style() -> str:
    """The style of a page that shows grids and plots."""
    shared = files("bench.reporting.page").joinpath("report.css").read_text(encoding="utf-8")
    return shared + files("bench.reporting.certificate").joinpath("certificate.css").read_text(encoding="utf-8")


def rendered(template: str, **values: Any) -> str:
    """A page of one of the templates below ``bench/reporting``."""
    return str(_templates().get_template(template).render(**values)) + "\n"


@cache
def _templates() -> Any:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    return Environment(
        loader=PackageLoader("bench.reporting", "."), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
