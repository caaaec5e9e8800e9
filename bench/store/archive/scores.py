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

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from bench.scoring.score import LEVELS, QUANTILES
from bench.store.archive.decimals import MISSING, NAN, from_codes, to_codes

HITS = tuple(f"_coverage_{round(100 * level)}" for level in LEVELS)
ENDINGS = ("_error_pct", "_ratio", "_pit", *HITS, "_interval_score_pct", "_crps_pct")
FAMILIES = (*(ending.strip("_") for ending in ENDINGS), "other")
MARGIN = 1e-10
RAW, NORMAL = -1, 0
COARSE = (0, 1, 2, 3, 4, 6, 8, 11, 15, 20, 27, 37, 50, 68, 92, 125, 170, 230, 310, 420)
"""Degrees of freedom that are tried first."""
TRIED = 5
"""Replicates on which the degrees of freedom are sought."""


def family(name: str) -> str:
    """Which scores a score stands among."""
    return next((ending.strip("_") for ending in ENDINGS if name.endswith(ending)), "other")


def pack(names: Sequence[str], codes: np.ndarray) -> dict[str, Any]:
    """Small numbers for codes of shape (n_names, n): by family, with ``above``, ``unsure`` and ``dof``."""
    packer = _Cell(names, codes.shape[1])
    packer.codes[:], packer.numbers[:] = codes, from_codes(codes)
    packer.dof = packer.best_dof()
    packer.above = packer.signs()
    for rows, guess, exact in packer.guesses():
        packer.keep(rows, guess, exact)
    parts: dict[str, Any] = {name: packer.parts[packer.of(name)].ravel().astype(np.int32) for name in FAMILIES}
    unsure = np.flatnonzero(packer.doubtful).astype(np.int32)
    return parts | {"above": packer.above.ravel(), "unsure": unsure, "dof": packer.dof}


class Unpacked:
    """The codes of which :func:`pack` made some numbers, in the order of :meth:`_Cell.guesses`, as far as asked for."""

    def __init__(self, names: Sequence[str], n: int, packed: Mapping[str, Any]) -> None:
        packer = self._packer = _Cell(names, n)
        for name in FAMILIES:
            rows = packer.of(name)
            packer.parts[rows] = np.asarray(packed[name], np.int32).reshape(rows.size, n)
        packer.above[:] = np.asarray(packed["above"], bool).reshape(packer.above.shape)
        packer.dof = int(packed["dof"])
        packer.doubtful.flat[np.asarray(packed["unsure"], int)] = True
        self.names, self.row = packer.names, packer.row
        self._known, self._guesses = np.zeros(len(self.names), bool), packer.guesses()

    def numbers_of(self, name: str) -> np.ndarray:
        """One score, (n,), NaN where it is missing; what comes behind it stays packed."""
        while not self._known[self.row[name]]:
            rows, guess, _ = next(self._guesses)
            self._packer.restore(rows, guess)
            self._known[rows] = True
        return self._packer.values(name)

    @property
    def codes(self) -> np.ndarray:
        """Of all scores, (n_names, n)."""
        for name in self.names:
            self.numbers_of(name)
        return self._packer.codes


class _Cell:
    """The scores of one cell while they are packed or unpacked, both in the order of :meth:`guesses`."""

    def __init__(self, names: Sequence[str], n: int) -> None:
        self.names, self.n = list(names), n
        self.row = {name: i for i, name in enumerate(self.names)}
        self.families = np.array([family(name) for name in self.names], object)
        self.codes = np.zeros((len(self.names), n), np.int64)
        self.parts = np.zeros((len(self.names), n), np.int64)
        self.quantities = [name[: -len("_error_pct")] for name in self.names if name.endswith("_error_pct")]
        self.above = np.zeros((len(self.quantities), n), bool)
        self.doubtful = np.zeros((len(self.names), n), bool)
        self.dof = RAW
        self.numbers = np.zeros((len(self.names), n))
        gauges = sorted({name[: -len("_error_pct")].partition("_over_")[2] for name in self.row if "_over_" in name})
        sources = {quantity: _sources(quantity, gauges, self.row) for quantity in self.quantities}
        self.sources = {quantity: found for quantity, found in sources.items() if found}

    def of(self, family_: str) -> np.ndarray:
        return np.flatnonzero(self.families == family_)

    def values(self, name: str) -> np.ndarray:
        """The numbers of a score, once its codes are known."""
        return np.asarray(self.numbers[self.row[name]])

    def keep(self, rows: Sequence[int], guess: np.ndarray | None, exact: bool) -> None:
        """Differences of some rows from a guess, shape (len(rows), n); an exact one is the same on every machine.

        No guess is as one of zeros.
        """
        expected: Any = 0 if guess is None else _expected(guess)
        if guess is not None and not exact:
            doubtful = to_codes(guess * (1 - MARGIN)) != to_codes(guess * (1 + MARGIN))
            self.doubtful[rows] = doubtful
            expected = np.where(doubtful, 0, expected)
        self.parts[rows] = _folded(self.codes[rows] - expected)

    def restore(self, rows: Sequence[int], guess: np.ndarray | None) -> None:
        expected: Any = 0 if guess is None else np.where(self.doubtful[rows], 0, _expected(guess))
        self.codes[rows] = _wrapped(_unfolded(self.parts[rows]) + expected)
        self.numbers[rows] = from_codes(self.codes[rows])

    def guesses(self) -> Iterator[tuple[list[int], np.ndarray | None, bool]]:
        """What is expected of all rows, some at a time; each group needs only those before it."""
        plain = [*self.of("pit"), *self.of("other")]
        yield plain, None, True
        yield [self.row[f"{q}_error_pct"] for q in self.quantities if q not in self.sources], None, True
        some = list(self.sources)
        yield [self.row[f"{q}_error_pct"] for q in some], self._stack([self._error(q) for q in some]), True
        some = [q for q in self.quantities if f"{q}_ratio" in self.row]
        yield [self.row[f"{q}_ratio"] for q in some], self._stack([self.ratio(q) for q in some]), True
        rest = [row for row in range(len(self.names)) if self.families[row] not in ("pit", "other", "error_pct")]
        lone = [row for row in rest if not self._guessed(row)]
        yield lone, None, True
        some = [q for q in self.quantities if f"{q}_pit" in self.row]
        for ending in (*HITS, "_interval_score_pct", "_crps_pct"):
            own = [q for q in some if f"{q}{ending}" in self.row]
            yield [self.row[f"{q}{ending}"] for q in own], self._belief(own, ending), ending in HITS

    def _guessed(self, row: int) -> bool:
        """Whether a score's quantity has what its guess needs."""
        name, own = self.names[row], self.families[row]
        quantity = name[: -len(own) - 1]
        return f"{quantity}_error_pct" in self.row and (own == "ratio" or f"{quantity}_pit" in self.row)

    def _stack(self, rows: list[np.ndarray]) -> np.ndarray:
        return np.stack(rows) if rows else np.zeros((0, self.n))

    def _error(self, quantity: str) -> np.ndarray:
        with np.errstate(all="ignore"):
            product = np.ones(self.n)
            for source, power in self.sources[quantity]:  # by operations that are the same on every machine
                ratio = self.ratio(source)
                product = product * (
                    ratio if power == 1.0 else np.sqrt(ratio) if power == 0.5 else 1.0 / np.sqrt(ratio)
                )
            return 100.0 * np.abs(product - 1.0)

    def ratio(self, quantity: str) -> np.ndarray:
        """The value over the true one, to the digits of its error."""
        above = self.above[self.quantities.index(quantity)]
        if f"{quantity}_pit" in self.row:
            above = above ^ (self.values(f"{quantity}_pit") < 0.5)
        error = self.values(f"{quantity}_error_pct") / 100.0
        return np.asarray(1.0 + np.where(above, error, -error))

    def signs(self) -> np.ndarray:
        """Whether each value is above the true one, or, where there is a level at the truth, not as that says."""
        signs = np.zeros_like(self.above)
        for i, quantity in enumerate(self.quantities):
            if f"{quantity}_ratio" in self.row:
                signs[i] = self.values(f"{quantity}_ratio") > 1.0
            if f"{quantity}_pit" in self.row:
                signs[i] ^= self.values(f"{quantity}_pit") < 0.5
        return signs

    def _belief(self, quantities: Sequence[str], ending: str) -> np.ndarray:
        """A score as a normal belief, or Student's t, in the logarithm would have it."""
        levels = self._stack([self.values(f"{q}_pit") for q in quantities])
        if ending in HITS:
            return (np.abs(levels - 0.5) <= LEVELS[HITS.index(ending)] / 2).astype(float)
        if self.dof == RAW or not quantities:
            return np.zeros_like(levels)
        ratios = self._stack([self.ratio(q) for q in quantities])
        return np.nan_to_num(_score(ending, ratios, levels, self.dof), nan=0.0, posinf=0.0, neginf=0.0)

    def best_dof(self) -> int:
        """The degrees of freedom that the interval scores agree with most (0 for a normal belief), or RAW."""
        own = [q for q in self.quantities if {f"{q}_pit", f"{q}_ratio", f"{q}_interval_score_pct"} <= set(self.row)]
        if not own:
            return RAW
        self.above = self.signs()
        scores = np.array([self.values(f"{q}_interval_score_pct")[:TRIED] for q in own])
        ratios = np.array([self.ratio(q)[:TRIED] for q in own])
        levels = np.array([self.values(f"{q}_pit")[:TRIED] for q in own])
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


def _expected(guess: np.ndarray) -> np.ndarray:
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
