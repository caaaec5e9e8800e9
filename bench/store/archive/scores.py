"""The scores of a cell as small integers: each number as its difference from what the others let expect.

What is expected decides only how much room a number takes: the difference is kept, so what comes back is what was
stored, to the last digit. Expected are

- a ratio from its error: ``1 ± error / 100``;
- the errors of dependent quantities from those of others: ``k = m · k/m``, ``f ~ sqrt(k/m)``,
  ``zeta ~ (c/m) / sqrt(k/m)``;
- hits, interval score and CRPS from ratio and level: the belief is normal, or Student's t, in the logarithm.

A guess that lies so near to the middle between two numbers that another machine might round it the other way is not
used (``unsure``).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from bench.scoring.score import LEVELS, QUANTILES
from bench.store.archive.decimals import MISSING, NAN, from_codes, to_codes

HITS = tuple(f"_coverage_{round(100 * level)}" for level in LEVELS)
ENDINGS = ("_error_pct", "_ratio", "_pit", *HITS, "_interval_score_pct", "_crps_pct")
FAMILIES = (*(ending.strip("_") for ending in ENDINGS), "other")
MARGIN = 1e-10
RAW, NORMAL = -1, 0
ONE = int(to_codes(np.array(1.0)))
COARSE = (0, 1, 2, 3, 4, 6, 8, 11, 15, 20, 27, 37, 50, 68, 92, 125, 170, 230, 310, 420)
"""Degrees of freedom that are tried first."""
TRIED = 5
"""Replicates on which the degrees of freedom are sought."""


def family(name: str) -> str:
    """Which scores a score stands among."""
    return next((ending.strip("_") for ending in ENDINGS if name.endswith(ending)), "other")


def pack(names: Sequence[str], codes: np.ndarray) -> dict[str, Any]:
    """Small numbers for codes of shape (n_names, n): by family, with ``above``, ``unsure`` and ``dof``."""
    packer = _Cell(_layout(tuple(names)), codes.shape[1])
    packer.codes[:], packer.numbers[:] = codes, from_codes(codes)
    packer.dof = packer.best_dof()
    packer.above = packer.signs()
    for step in packer.layout.steps:
        packer.keep(step)
    of = packer.layout.of
    parts: dict[str, Any] = {name: packer.parts[rows].ravel().astype(np.int32) for name, rows in of.items()}
    unsure = np.flatnonzero(packer.doubtful).astype(np.int32)
    return parts | {"above": packer.above.ravel(), "unsure": unsure, "dof": packer.dof}


class Unpacked:
    """The codes of which :func:`pack` made some numbers: those of a step, and of the steps it needs, as asked for."""

    def __init__(self, names: Sequence[str], n: int, packed: Mapping[str, Any]) -> None:
        layout = _layout(tuple(names))
        packer = self._packer = _Cell(layout, n)
        for name, rows in layout.of.items():
            packer.parts[rows] = np.asarray(packed[name], np.int32).reshape(rows.size, n)
        packer.above[:] = np.asarray(packed["above"], bool).reshape(packer.above.shape)
        packer.dof = int(packed["dof"])
        packer.doubtful.flat[np.asarray(packed["unsure"], int)] = True
        self.names, self.row, self._known = layout.names, layout.row, set[int]()

    def numbers_of(self, name: str) -> np.ndarray:
        """One score, (n,), NaN where it is missing; what it does not need stays packed."""
        self._restore(self._packer.layout.step_of[name])
        return self._packer.values(name)

    def _restore(self, number: int) -> None:
        if number not in self._known:
            step = self._packer.layout.steps[number]
            for before in step.needs:
                self._restore(before)
            self._packer.restore(step)
            self._known.add(number)

    @property
    def codes(self) -> np.ndarray:
        """Of all scores, (n_names, n)."""
        for number in range(len(self._packer.layout.steps)):
            self._restore(number)
        return self._packer.codes


@dataclass(frozen=True)
class _Step:
    """Scores that are guessed together, those of an ``ending`` of some quantities; none is where nothing is guessed.

    ``needs``: the steps that the guess is made from. An ``exact`` guess is the same on every machine.
    """

    ending: str
    quantities: Sequence[str]
    rows: Sequence[int]
    needs: tuple[int, ...] = ()
    exact: bool = True


class _Layout:
    """What the names of a cell's scores say: which stand together, and of what each is guessed."""

    def __init__(self, names: tuple[str, ...]) -> None:
        self.names = names
        self.row = {name: i for i, name in enumerate(names)}
        self.families = [family(name) for name in names]
        self.of = {own: np.flatnonzero([own == one for one in self.families]) for own in FAMILIES}
        self.quantities = [name[: -len("_error_pct")] for name in names if name.endswith("_error_pct")]
        self.place = {quantity: i for i, quantity in enumerate(self.quantities)}
        gauges = sorted({name[: -len("_error_pct")].partition("_over_")[2] for name in self.row if "_over_" in name})
        sources = {quantity: _sources(quantity, gauges, self.row) for quantity in self.quantities}
        self.sources = {quantity: found for quantity, found in sources.items() if found}
        self.steps = self._steps()
        self.step_of = {names[row]: number for number, step in enumerate(self.steps) for row in step.rows}

    def _steps(self) -> list[_Step]:
        plain, own, dependent = 0, 1, 2
        rest = [row for row, own in enumerate(self.families) if own not in ("pit", "other", "error_pct")]
        steps = [
            _Step("", (), [*self.of["pit"], *self.of["other"]]),
            _Step("", (), self.rows((q for q in self.quantities if q not in self.sources), "_error_pct")),
            _Step("_error_pct", list(self.sources), self.rows(self.sources, "_error_pct"), (plain, own)),
            _Step("", (), [row for row in rest if not self._guessed(row)]),
        ]
        some = [q for q in self.quantities if f"{q}_ratio" in self.row]
        steps.append(_Step("_ratio", some, self.rows(some, "_ratio"), (plain, own, dependent)))
        for ending in (*HITS, "_interval_score_pct", "_crps_pct"):
            some = [q for q in self.quantities if f"{q}_pit" in self.row and f"{q}{ending}" in self.row]
            needs = (plain,) if ending in HITS else (plain, own, dependent)
            steps.append(_Step(ending, some, self.rows(some, ending), needs, exact=ending in HITS))
        return steps

    def rows(self, quantities: Iterable[str], ending: str) -> list[int]:
        return [self.row[f"{quantity}{ending}"] for quantity in quantities]

    def _guessed(self, row: int) -> bool:
        """Whether a score's quantity has what its guess needs."""
        name, own = self.names[row], self.families[row]
        quantity = name[: -len(own) - 1]
        return f"{quantity}_error_pct" in self.row and (own == "ratio" or f"{quantity}_pit" in self.row)


_layout = cache(_Layout)
"""Cells of one method and system share it."""


class _Cell:
    """The scores of one cell while they are packed or unpacked, step by step."""

    def __init__(self, layout: _Layout, n: int) -> None:
        self.layout, self.n = layout, n
        shape = len(layout.names), n
        self.codes, self.parts = np.zeros(shape, np.int64), np.zeros(shape, np.int64)
        self.numbers, self.doubtful = np.zeros(shape), np.zeros(shape, bool)
        self.above = np.zeros((len(layout.quantities), n), bool)
        self.dof = RAW

    def values(self, name: str) -> np.ndarray:
        """The numbers of a score, once its codes are known."""
        return np.asarray(self.numbers[self.layout.row[name]])

    def keep(self, step: _Step) -> None:
        """The differences of some scores from what is expected."""
        guess, rows = self._guess(step), step.rows
        expected = _expected(guess)
        if guess is not None and not step.exact:
            doubtful = to_codes(guess * (1 - MARGIN)) != to_codes(guess * (1 + MARGIN))
            self.doubtful[rows] = doubtful
            expected = np.where(doubtful, 0, expected)
        self.parts[rows] = _folded(self.codes[rows] - expected)

    def restore(self, step: _Step) -> None:
        """The scores again."""
        expected, rows = _expected(self._guess(step)), step.rows
        if not step.exact:
            expected = np.where(self.doubtful[rows], 0, expected)
        self.codes[rows] = _wrapped(_unfolded(self.parts[rows]) + expected)
        self.numbers[rows] = from_codes(self.codes[rows])

    def _guess(self, step: _Step) -> np.ndarray | None:
        """What is expected of the scores of a step, (len(rows), n), as numbers or as yes and no; no guess is as 0."""
        if not step.quantities:
            return None
        if step.ending == "_error_pct":
            return self._errors(step.quantities)
        if step.ending == "_ratio":
            return self.ratios(step.quantities)
        return self._belief(step.quantities, step.ending)

    def _errors(self, quantities: Sequence[str]) -> np.ndarray:
        sources = [self.layout.sources[quantity] for quantity in quantities]
        names = list(dict.fromkeys(name for own in sources for name, _ in own))
        ratios = dict(zip(names, self.ratios(names), strict=True))
        errors = np.empty((len(quantities), self.n))
        with np.errstate(all="ignore"):
            for error, own in zip(errors, sources, strict=True):
                product = np.ones(self.n)
                for source, power in own:  # by operations that are the same on every machine
                    ratio = ratios[source]
                    product *= ratio if power == 1.0 else np.sqrt(ratio) if power == 0.5 else 1.0 / np.sqrt(ratio)
                error[:] = 100.0 * np.abs(product - 1.0)
        return errors

    def ratios(self, quantities: Sequence[str]) -> np.ndarray:
        """The values over the true ones, (len(quantities), n), to the digits of their errors."""
        above = self.above[[self.layout.place[quantity] for quantity in quantities]]
        levelled = [i for i, quantity in enumerate(quantities) if f"{quantity}_pit" in self.layout.row]
        above[levelled] ^= self._of([quantities[i] for i in levelled], "_pit") < 0.5
        errors = self._of(quantities, "_error_pct") / 100.0
        return np.asarray(1.0 + np.where(above, errors, -errors))

    def _of(self, quantities: Sequence[str], ending: str) -> np.ndarray:
        """The numbers of a score of some quantities, (len(quantities), n)."""
        return np.asarray(self.numbers[self.layout.rows(quantities, ending)])

    def signs(self) -> np.ndarray:
        """Whether each value is above the true one, or, where there is a level at the truth, not as that says."""
        signs = np.zeros_like(self.above)
        for i, quantity in enumerate(self.layout.quantities):
            if f"{quantity}_ratio" in self.layout.row:
                signs[i] = self.values(f"{quantity}_ratio") > 1.0
            if f"{quantity}_pit" in self.layout.row:
                signs[i] ^= self.values(f"{quantity}_pit") < 0.5
        return signs

    def _belief(self, quantities: Sequence[str], ending: str) -> np.ndarray:
        """A score as a normal belief, or Student's t, in the logarithm would have it."""
        levels = self._of(quantities, "_pit")
        if ending in HITS:
            return np.asarray(np.abs(levels - 0.5) <= LEVELS[HITS.index(ending)] / 2)
        if self.dof == RAW:
            return np.zeros_like(levels)
        guess = _score(ending, self.ratios(quantities), levels, self.dof)
        return np.nan_to_num(guess, nan=0.0, posinf=0.0, neginf=0.0)

    def best_dof(self) -> int:
        """The degrees of freedom that the interval scores agree with most (0 for a normal belief), or RAW."""
        needed = ("_pit", "_ratio", "_interval_score_pct")
        own = [q for q in self.layout.quantities if all(f"{q}{ending}" in self.layout.row for ending in needed)]
        if not own:
            return RAW
        self.above = self.signs()
        scores = self._of(own, "_interval_score_pct")[:, :TRIED]
        ratios, levels = self.ratios(own)[:, :TRIED], self._of(own, "_pit")[:, :TRIED]
        gaps = {RAW: _gap(np.zeros_like(scores), scores)}

        def best(candidates: Iterable[int]) -> int:
            for dof in candidates:
                guess = _score("_interval_score_pct", ratios, levels, dof)
                gaps[dof] = _gap(np.nan_to_num(guess, nan=0.0, posinf=0.0, neginf=0.0), scores)
            return min(gaps, key=lambda dof: (gaps[dof], dof))

        found = best(COARSE)
        while found > NORMAL and (beside := [dof for dof in _beside(found, sorted(gaps)) if dof not in gaps]):
            found = best(beside)
        return found


def _beside(dof: int, tried: Sequence[int]) -> list[int]:
    """Half way to the next ones that were tried, either way."""
    i = tried.index(dof)
    return [(dof + other) // 2 for other in (tried[i - 1], tried[min(i + 1, len(tried) - 1)]) if other > NORMAL]


def _gap(guess: np.ndarray, scores: np.ndarray) -> float:
    return float(np.sum(np.log2(1.0 + np.abs(to_codes(guess) - to_codes(scores)))))


def _sources(quantity: str, gauges: Sequence[str], row: Mapping[str, int]) -> list[tuple[str, float]] | None:
    """The quantities, and their powers, of which one is the product; None for one that stands for itself."""
    if "_over_" in quantity or quantity in gauges:
        return None
    known = {
        "natural_frequency": [("k_over_m", 0.5)],
        "damping_ratio": [("c_over_m", 1.0), ("k_over_m", -0.5)],
    }
    choices = [known[quantity]] if quantity in known else [[(g, 1.0), (f"{quantity}_over_{g}", 1.0)] for g in gauges]
    return next((found for found in choices if all(f"{name}_error_pct" in row for name, _ in found)), None)


def _score(ending: str, ratios: np.ndarray, levels: np.ndarray, dof: int) -> np.ndarray:
    """Interval score (95 %) or CRPS, in % of the truth, of beliefs with this median over the truth and level at it."""

    from scipy.special import ndtri, stdtrit  # by whom beliefs are asked for, which few readers do

    def standard(level: Any) -> Any:
        return ndtri(level) if dof == NORMAL else stdtrit(dof, level)

    with np.errstate(all="ignore"):
        centre = np.log(ratios)
        sd = np.abs(centre / standard(levels))
        if ending == "_crps_pct":
            total = np.zeros_like(ratios)
            for level, z in zip(QUANTILES, standard(QUANTILES), strict=True):
                off = np.expm1(centre + sd * z)
                total += off * ((off > 0) - level)
            return np.asarray(100.0 * 2.0 * total / len(QUANTILES))
        half = standard(0.975) * sd
        low, high = np.expm1(centre - half), np.expm1(centre + half)
        return np.asarray(100.0 * ((high - low) + 40.0 * (np.maximum(low, 0) + np.maximum(-high, 0))))


def _expected(guess: np.ndarray | None) -> Any:
    """The codes of a guess, 0 where it is no number."""
    if guess is None:
        return 0
    if guess.dtype == bool:
        return np.where(guess, ONE, 0)
    codes = to_codes(guess)
    return np.where((codes == NAN) | (codes == MISSING), 0, codes)


def _wrapped(numbers: np.ndarray) -> np.ndarray:
    """To the 32 bits that a code has."""
    return np.asarray((numbers + 2**31) % 2**32 - 2**31)


def _folded(numbers: np.ndarray) -> np.ndarray:
    """Small numbers of either sign as small positive ones (0, -1, 1, -2, ... as 0, 1, 2, 3, ...), in 32 bits."""
    numbers = _wrapped(numbers)
    return _wrapped(np.where(numbers >= 0, 2 * numbers, -2 * numbers - 1))


def _unfolded(numbers: np.ndarray) -> np.ndarray:
    numbers = np.asarray(numbers, np.int64) % 2**32
    return np.where(numbers % 2 == 0, numbers // 2, -(numbers // 2) - 1)
