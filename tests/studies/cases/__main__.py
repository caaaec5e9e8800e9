"""Records that real ones resemble, drawn by a seed with the truth known: right, honest, or wrong and trusted.

An answer is *right* where every stated interval holds the true value and can be printed (its ends within a factor of
three of the value), *wide* where one cannot be, *missed* where the true value lies outside but within three
half-widths (5 % of intervals of 95 % do), *wrong* beyond that. A record that is refused, or whose answer is withdrawn,
is *honest* where this is allowed and the right reason is given, *refused* else. *Unsaid* is a right answer without the
sentence that the kind asks for. All of this is of the interval of a repeat; beside it stand how many intervals of this
record hold the true value, and the median half-widths of a repeat's.
"""

from __future__ import annotations

import math
import re
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np

import bench
from bench.commands.declaration import OneOf, Within
from bench.errors import InputError
from bench.reporting.tables.render import markdown_table
from tests.studies.cases.kinds import KINDS, Case
from tests.studies.common import Count, study, tracked

OUTCOMES = ("right", "honest", "unsaid", "missed", "wide", "refused", "crashed", "wrong", "WRONG AND TRUSTED")
FACTOR, HALF_WIDTHS = 3.0, 3.0
NEAR = {"k_over_m": 0.1, "c_over_m": 0.7}
"""Largest error of a logarithm that is not wrong, however wide the interval."""
NAMED = 0.03
SECONDS = 30.0


@dataclass(frozen=True)
class Judgment:
    """An outcome, the verdict of the answer, and why."""

    outcome: str
    verdict: str
    why: str


@dataclass
class Tally:
    """Outcomes of a kind; how many of the ``stated`` intervals of a record hold the truth; widths (logs); seconds."""

    outcomes: Counter[str] = field(default_factory=Counter)
    covered: int = 0
    stated: int = 0
    widths: dict[str, list[float]] = field(default_factory=lambda: {"k_over_m": [], "c_over_m": []})
    seconds: list[float] = field(default_factory=list)

    def add(self, case: Case, found: Any, outcome: str, seconds: float) -> None:
        """Count an answer."""
        self.outcomes[outcome] += 1
        self.seconds.append(seconds)
        for name, own in getattr(found, "estimates", {}).items():
            true = case.truth.get(name)
            if true is not None and not own.limit:
                self.stated += 1
                self.covered += own.record_low <= true <= own.record_high
                if name in self.widths:
                    self.widths[name].append(math.log(own.high / own.low) / 2)

    def __add__(self, other: Tally) -> Tally:
        widths = {name: [*own, *other.widths[name]] for name, own in self.widths.items()}
        seconds = [*self.seconds, *other.seconds]
        return Tally(
            self.outcomes + other.outcomes, self.covered + other.covered, self.stated + other.stated, widths, seconds
        )

    def row(self) -> list[str]:
        """Return the outcomes, the coverage by this record's intervals, median half-widths of a repeat's, and time."""
        middle = [f"{100 * math.expm1(np.median(own)):.2g} %" if own else "-" for own in self.widths.values()]
        return [
            *(str(self.outcomes[o] or "") for o in OUTCOMES),
            f"{self.covered} of {self.stated}" if self.stated else "-",
            ", ".join(middle),
            f"{np.mean(self.seconds):.1f}",
        ]


def answer(case: Case) -> Any:
    """What :func:`bench.identify` says of a case: an Identification, or the sentence of the refusal."""
    data = case.data if isinstance(case.data, tuple) else (case.data,)
    try:
        return bench.identify(*data, method="shooting", timeout_s=SECONDS, **case.fields)
    except InputError as error:
        return re.sub(r"/\S+/", "", str(error))  # a folder's name says nothing
    except Exception as error:
        return error


def judged(case: Case, found: Any) -> Judgment:
    """Judge an answer, a refusal or an exception."""
    if isinstance(found, Exception):
        return Judgment("crashed", "-", "".join(traceback.format_exception_only(found)).strip())
    if isinstance(found, str):
        return _refusal(case, "refused", found)
    said = "; ".join([*found.notes, *found.reasons, found.message])
    if found.trust == "do not trust" or not found.estimates:
        return _refusal(case, found.trust, said)
    named = _named(case.frequencies, said)
    asked = {**dict.fromkeys(found.estimates), **case.truth}
    faults = [_fault(name, true, found.estimates.get(name)) for name, true in asked.items()]
    worst, why = max(faults, key=lambda fault: OUTCOMES.index(fault[0]), default=("right", ""))
    if case.frequencies and not named and (worst != "right" or not case.truth):
        worst = "unsaid" if _of_one(case.frequencies, found.estimates) and not case.truth else "wrong"
        why = f"{case.frequencies} Hz not named; {why}"
    elif case.frequencies and named:
        worst, why = "honest", ""
    if (worst == "wrong" or case.never) and found.trust == "trust":
        worst, why = "WRONG AND TRUSTED", why or "must not be trusted"
    if worst == "right" and not re.search(case.says, said, re.IGNORECASE):
        worst, why = "unsaid", f"nothing like {case.says!r} in: {said[:160]}"
    return Judgment(worst, found.trust, why or said[:100])


def _refusal(case: Case, verdict: str, said: str) -> Judgment:
    right = case.refusal and re.search(case.says, said, re.IGNORECASE)
    honest = bool(right) and (bool(case.truth) or _named(case.frequencies, said))
    return Judgment("honest" if honest else "refused", verdict, said[:200])


def _fault(name: str, true: float | None, own: Any) -> tuple[str, str]:
    """What is wrong with a stated interval, and how it is said."""
    if own is None:
        return ("wide", f"{name} is not stated") if true is not None else ("right", "")
    limit = getattr(own, "limit", "")
    low, high = (-math.inf if limit == "at most" else own.low), (math.inf if limit == "at least" else own.high)
    said = f"{name} {own.value:.4g} [{own.low:.4g}, {own.high:.4g}] {limit}, true {true or math.nan:.4g}"
    printable = limit or (own.low > 0 and max(own.high / own.value, own.value / own.low) <= FACTOR)
    if true is None or low <= true <= high:
        if true is not None and not limit and abs(math.log(max(own.value, 1e-300) / true)) > NEAR.get(name, 1.0):
            return "wide", said
        return ("right", "") if printable else ("wide", said)
    half = (own.high - own.low) / 2 if not limit else abs(own.high if limit == "at most" else own.low) / 2
    if abs(own.value - true) <= HALF_WIDTHS * half and (limit or abs(math.log(own.value / true)) <= NEAR.get(name, 1)):
        return "missed", said
    return "wrong", said


def _of_one(frequencies: tuple[float, ...], estimates: Mapping[str, Any]) -> bool:
    """Whether the interval of the natural frequency holds one of some frequencies."""
    own = estimates.get("natural_frequency")
    return own is not None and any(own.low <= f <= own.high for f in frequencies)


def _named(frequencies: tuple[float, ...], said: str) -> bool:
    """Whether the text names all of some frequencies in Hz."""
    there = [float(number) for number in re.findall(r"(\d+(?:\.\d+)?)(?= (?:Hz|and|or|\())", said)]
    return all(any(abs(value / f - 1) < NAMED for value in there) for f in frequencies)


def cases(
    seed: Annotated[int, Within(ge=0), "seed of the draw, chosen on the day"],
    each: Annotated[Count, "records of each kind"] = 10,
    kinds: Annotated[tuple[str, ...], OneOf(tuple(KINDS)), "kinds that are drawn"] = tuple(KINDS),
    keep: Annotated[Path | None, "folder in which the records are left"] = None,
    detail: Annotated[bool, "a line for each record that is neither right nor honest"] = True,
) -> int:
    """Count what is said of records of each kind; exit status 1 where an answer is wrong and trusted."""
    tallies = {kind: Tally() for kind in kinds}
    with tempfile.TemporaryDirectory() as scratch:
        for kind, i in tracked([(kind, i) for kind in kinds for i in range(each)], "record"):
            folder = (keep or Path(scratch)) / kind / str(i)
            folder.mkdir(parents=True, exist_ok=True)
            case = KINDS[kind](np.random.default_rng([seed, list(KINDS).index(kind), i]), folder)
            started = time.perf_counter()
            found = answer(case)
            judgment = judged(case, found)
            tallies[kind].add(case, found, judgment.outcome, time.perf_counter() - started)
            if detail and judgment.outcome not in ("right", "honest"):
                print(f"{kind} #{i}: {judgment.outcome} ({judgment.verdict}): {judgment.why}", flush=True)
    total = sum(tallies.values(), Tally())
    rows = [[kind, *tally.row()] for kind, tally in {**tallies, "all": total}.items()]
    print(markdown_table(rows, ("kind", *OUTCOMES, "this record", "k/m, c/m within", "s each")))
    return int(total.outcomes[OUTCOMES[-1]] > 0)


main = partial(study, cases, "tests.studies.cases")

if __name__ == "__main__":
    sys.exit(main())
