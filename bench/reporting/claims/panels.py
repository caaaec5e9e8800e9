"""Panels: passages of a document that show lines of a generated table, to the letter."""

from __future__ import annotations

import re
from pathlib import Path

from bench.errors import InputError

PANEL = re.compile(
    r"(?P<open><!-- (?P<name>(?P<chosen>chosen rows of )?table (?P<number>\d)) -->\n).*?(?P<close><!-- /(?P=name) -->)",
    re.DOTALL,
)
"""``<!-- table 3 -->``: the table for a known start; ``<!-- chosen rows of table 3 -->``: few rows of the other."""
CHOSEN = (
    "bound",
    "prior (no data)",
    "Multiple shooting",
    "Bayesian MCMC",
    "PINN",
    "Matrix pencil",
    "IQML",
    "Logarithmic decrement",
    "SINDy",
    "LS, finite differences",
    "DDNN",
)
"""One method of each kind, beside the bound and what is known without data."""
COLUMNS = ("method", "k/m error %", "c/m error %", "RMSE (m)")


def with_panels(text: str, results: Path) -> str:
    """The text with every panel as the table in the folder of results has it now; raises InputError without one."""

    def panel(found: re.Match[str]) -> str:
        path = results / f"table{found['number']}.md"
        if not path.is_file():
            raise InputError("results", path, "there is no such table; write it with python -m bench tables")
        table = path.read_text(encoding="utf-8")
        shown = chosen(section(table, "unknown")) if found["chosen"] else section(table, "known")
        return f"{found['open']}{shown}\n{found['close']}"

    return PANEL.sub(panel, text)


def section(table: str, start: str) -> str:
    """What a table has for a start, known or unknown."""
    return table.partition(f"## Initial state {start}\n")[2].partition("\n##")[0].strip()


def chosen(panel: str) -> str:
    """The chosen rows and columns of a panel; raises InputError for one that it lacks."""
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in panel.split("\n") if line.startswith("|")]
    head, by_name = rows[0], {row[0]: row for row in rows[2:]}
    if missing := [*(set(COLUMNS) - set(head)), *(set(CHOSEN) - set(by_name))]:
        raise InputError("panel", ", ".join(sorted(missing)), "a row or column of the table")
    places = [head.index(column) for column in COLUMNS]
    lines = [head, ["---"] * len(head), *(by_name[name] for name in CHOSEN)]
    return "\n".join("| " + " | ".join(line[place] for place in places) + " |" for line in lines)
