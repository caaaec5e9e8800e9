"""A claim: a passage of prose, the expression that fills its numbers in, and what must be so for it to be true."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from inspect import cleandoc
from string import Formatter
from textwrap import fill

from bench.errors import InputError
from bench.reporting.claims.evidence import Evidence
from bench.reporting.page.words import joined

WIDTH = 120
"""Letters in a line of a filled passage."""


@dataclass(frozen=True)
class Said:
    """What the results say to a claim: its numbers by name, and of each condition whether it holds."""

    numbers: Mapping[str, str]
    conditions: Mapping[str, bool]

    @property
    def broken(self) -> list[str]:
        """The conditions that do not hold."""
        return [condition for condition, holds in self.conditions.items() if not holds]


@dataclass(frozen=True)
class Claim:
    """One passage, a paragraph or a point of a list; ``{name}`` in its text is a number of that name."""

    name: str
    text: str
    expression: Callable[[Evidence], Said]

    def said(self, evidence: Evidence) -> Said:
        """What the results say; raises InputError where text and expression name different numbers."""
        found = self.expression(evidence)
        named = {name for _, name, _, _ in Formatter().parse(self.text) if name is not None}
        if named != set(found.numbers):
            differ = ", ".join(sorted(named ^ set(found.numbers)))
            raise InputError("claim", self.name, f"text and expression differ in {differ}")
        return found

    def filled(self, said: Said, up: str = "") -> str:
        """The passage with its numbers, in lines of at most 120 letters; a point of a list begins with ``- ``.

        ``up`` leads from the document's folder to the one that holds ``results``: links in the text start there.
        """
        text = self.text.format_map(said.numbers).replace("](results/", f"]({up}results/")
        points = re.split(r"\n(?=- )", text)
        return "\n".join(
            fill(
                " ".join(point.split()),
                WIDTH,
                subsequent_indent="  " if point.startswith("- ") else "",
                break_long_words=False,
                break_on_hyphens=False,
            )
            for point in points
        )


def claim(expression: Callable[[Evidence], Said]) -> Claim:
    """Make a claim of an expression: its docstring is the text, its name the name."""
    assert expression.__doc__, "a claim says something"
    return Claim(expression.__name__, cleandoc(expression.__doc__), expression)


def said(conditions: Mapping[str, bool], **numbers: str) -> Said:
    """What the results say: conditions in words, and the numbers as they are to be written."""
    return Said(numbers, {condition: bool(holds) for condition, holds in conditions.items()})


def within(values: Iterable[float], low: float, high: float) -> bool:
    """Whether all values lie between two limits."""
    return all(low <= value <= high for value in values)


# ---- numbers as they are written


def number(value: float, digits: int = 2) -> str:
    """With that many significant digits, thousands parted: ``0.93``, ``38``, ``1,363``."""
    rounded = float(f"{value:.{digits}g}")
    decimals = max(0, digits - len(f"{abs(rounded):.0f}")) if abs(rounded) >= 1 else None
    return f"{rounded:.{digits}g}" if decimals is None else f"{value:,.{decimals}f}"


def fold(value: float) -> str:
    """An excess over the bound, or a ratio: hundredths below 10, whole above."""
    return f"{value:.2f}" if value < 9.995 else f"{value:,.0f}"


def span(values: Iterable[float], form: Callable[[float], str] = fold) -> str:
    """``low to high``, or one number where both are written alike."""
    found = list(values)
    low, high = form(min(found)), form(max(found))
    return low if low == high else f"{low} to {high}"


def percent(share: float) -> str:
    """A share in whole percent, without the sign."""
    return f"{100 * share:.0f}"


def listed(values: Iterable[float], form: Callable[[float], str] = fold) -> str:
    """``a, b and c``."""
    return joined([form(value) for value in values])


def exceptions(lines: Sequence[tuple[str, float]], over: float) -> str:
    """Of (what, excess) those above a limit: ``a (2.15) and b (1.28)``; ``none`` without any."""
    return joined([f"{what} ({fold(value)})" for what, value in lines if value > over]) or "none"
