"""Test a submitted method on problems of a secret seed, which it reads from files.

Recomputed rows prove that the method gives the submitted estimates, but not that these come from the data: a method
could draw the true values of a public scenario from its public seed. Therefore scenarios of the submission are varied
by a secret seed, and the errors over their bounds must have the distribution of the submitted errors.
"""

from __future__ import annotations

import csv
import math
import secrets
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bench.config.overrides import literal
from bench.contract.estimate import Status
from bench.engine.pool import Limits
from bench.errors import InputError
from bench.information.fisher import Bound
from bench.isolation.secrecy import close_memory
from bench.rounds.draw import DrawnProblem, with_truth
from bench.rounds.folder import PROBLEMS
from bench.rounds.problem_file import problem_files, short_name
from bench.rounds.secret import SEED_BYTES, SecretStream
from bench.scoring.row import Row
from bench.store.cell import Cell
from bench.store.stored_cell import StoredCell

VARIED = 0.25
"""Largest change of the logarithm of a parameter in a varied scenario, which stays as difficult as the original."""
SIGNIFICANT = 1e-3
"""Probability below which two samples of errors count as different: one honest submission in a thousand is refused."""
LEAST_ERROR = 1e-6
"""Smallest relative error that is distinguished: the rounding of numbers in files."""
Submitted = tuple[StoredCell, Cell, Bound]


@dataclass(frozen=True)
class FreshComparison:
    """Median errors over the bound, as submitted and on fresh problems, and the p-value of their difference."""

    problems: int
    submitted: float
    fresh: float
    p_value: float

    @property
    def differs(self) -> bool:
        return self.p_value < SIGNIFICANT

    def __str__(self) -> str:
        medians = f"median error over bound {self.submitted:.2g} as submitted, {self.fresh:.2g} on fresh data"
        end = "they differ" if self.differs else "they agree"
        return f"{self.problems} problems of a secret seed, given by file: {medians}; {end} (p = {self.p_value:.2g})"


def compare_fresh(submitted: Sequence[Submitted], problems: int, limits: Limits) -> FreshComparison | None:
    """Solve varied scenarios of a submission; None if none is requested, or files cannot represent them.

    The test is that of Mann and Whitney (Ann. Math. Stat. 18:50, 1947), of one number a data set: the mean over its
    quantities of the logarithm of error over bound. A failure counts as an infinite error.
    """
    from scipy.stats import mannwhitneyu

    if not problems:
        return None
    close_memory()  # this process holds the true values
    rng = SecretStream(secrets.randbits(8 * SEED_BYTES))
    order = sorted(submitted, key=lambda _: rng.random())
    before: dict[str, list[float]] = {}
    drawn: dict[str, tuple[Cell, list[DrawnProblem]]] = {}
    for number in range(problems):
        stored, cell, bound = order[number % len(order)]
        try:
            problem = _varied(f"P{number + 1:03d}", cell, rng)
        except (InputError, np.linalg.LinAlgError):  # of a kind without files, or nothing is identifiable
            continue
        drawn.setdefault(repr(cell.settings), (cell, []))[1].append(problem)
        before[stored.identity] = [_submitted_error(row, problem.truth, bound) for row in stored.rows]
    errors = [error for cell, of_cell in drawn.values() for error in _solved(cell, of_cell, limits)]
    if not errors:
        return None
    submitted_errors = [error for of_cell in before.values() for error in of_cell]
    medians = [float(10 ** np.median(logs)) for logs in (submitted_errors, errors)]
    p_value = float(mannwhitneyu(submitted_errors, errors).pvalue)
    return FreshComparison(len(errors), medians[0], medians[1], p_value)


def _varied(name: str, cell: Cell, rng: SecretStream) -> DrawnProblem:
    """Return a problem like those of a cell, with other parameters, noise and nominal values."""
    scenario = cell.scenario
    if scenario.truth_drawn:
        raise InputError("prior", name, "one whose truth is fixed")
    other = {key: value * math.exp(rng.uniform(-VARIED, VARIED)) for key, value in scenario.parameters.items()}
    problem = with_truth(name, "", replace(scenario, parameters=other), secrets.randbits(8 * SEED_BYTES))
    problem_files(name, problem.problem, list(problem.truth))
    return problem


def _solved(cell: Cell, drawn: Sequence[DrawnProblem], limits: Limits) -> list[float]:
    """Return the errors of a method in a process that reads files alone, infinite for failed fits.

    Raises InputError if the process itself fails.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / PROBLEMS).mkdir()
        for problem in drawn:
            for file, text in problem_files(problem.name, problem.problem, list(problem.truth)).items():
                (folder / PROBLEMS / file).write_bytes(text.encode())
        settings = [f"method.{key}={literal(value)}" for key, value in cell.settings.items()]
        words = ["round", "solve", name, f"method={cell.method}", f"out={folder / 'answers.csv'}", *settings,
                 f"timeout_s={limits.timeout_s}", f"memory_mb={limits.memory_mb}"]  # fmt: skip
        done = subprocess.run([sys.executable, "-m", "bench", *words], capture_output=True, text=True)
        if done.returncode:
            reason = done.stderr.strip().rpartition("\n")[2]
            raise InputError("submission", cell.method, f"fresh problems could not be solved: {reason}")
        lines = (folder / "answers.csv").read_text(encoding="utf-8").splitlines()
    answers = {(row["scenario"], row["quantity"]): float(row["value"] or "nan") for row in csv.DictReader(lines)}
    return [
        _mean_log(
            (answers.get((problem.name, short_name(quantity)), math.nan) / value - 1.0, bound / value)
            for quantity, (value, bound) in problem.truth.items()
        )
        for problem in drawn
    ]  # fmt: skip


def _submitted_error(row: Row, quantities: Iterable[str], bound: Bound) -> float:
    if row.status is not Status.OK:
        return math.inf
    return _mean_log((row.scores.get(f"{q}_error_pct", math.nan) / 100.0, bound.relative_sd[q]) for q in quantities)


def _mean_log(errors: Iterable[tuple[float, float]]) -> float:
    """Return the mean logarithm of relative errors over their bounds; infinite where one is not finite."""
    logs = [math.log10(max(abs(error), LEAST_ERROR) / bound) for error, bound in errors if not math.isnan(error)]
    return float(np.mean(logs)) if logs else math.inf
