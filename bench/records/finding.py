"""Result of identifying measured records with one method: values, intervals, residuals, reasons for caution."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from bench.contract.estimate import Estimate
from bench.contract.problem import Problem
from bench.records.intervals import StatedInterval
from bench.records.linearised_fit import LinearisedFit
from bench.records.modes import OfferedMode
from bench.records.problem import Measured
from bench.records.verdict import Reason, Trust, verdict
from bench.systems import MEASURED


@dataclass(frozen=True, eq=False)
class Run:
    """One of several records, identified separately.

    Attributes:
        name: Name of its file.
        finding: Result of this record alone.
        left_out: Reason for which it is excluded from the combined result; empty if it is included.
    """

    name: str
    finding: Finding
    left_out: str = ""


@dataclass(frozen=True, eq=False)
class Finding:
    """Result of identifying measured records with one method.

    Attributes:
        method: Name of the method.
        measured: The records, with the fitted system.
        estimate: The method's estimate, or a failed one with its status.
        wall_s: Computing time of the fit (s).
        stated: Intervals by name of the quantity.
        reasons: Reasons for caution.
        fit: Linearised likelihood at the estimate, in natural units; None for a failed estimate.
        modes: Candidate modes, where the record shows several or an alias.
        runs: Repeats that were identified separately; all attributes except ``stated`` and ``reasons`` are then those
            of the median run.
    """

    method: str
    measured: Measured
    estimate: Estimate
    wall_s: float = math.nan
    stated: Mapping[str, StatedInterval] = field(default_factory=dict)
    reasons: tuple[Reason, ...] = ()
    fit: LinearisedFit | None = None
    modes: tuple[OfferedMode, ...] = ()
    runs: tuple[Run, ...] = ()

    @property
    def trust(self) -> Trust:
        """Verdict of the reasons."""
        return verdict(self.reasons)

    @property
    def intervals(self) -> Mapping[str, StatedInterval]:
        """Stated intervals; empty if the estimate is not trusted."""
        return {} if self.trust is Trust.NO else self.stated

    @property
    def withdrawn(self) -> Mapping[str, StatedInterval]:
        """Intervals of an estimate that is not trusted; otherwise empty."""
        return self.stated if self.trust is Trust.NO else {}

    @property
    def problem(self) -> Problem:
        return self.measured.problem

    @property
    def channel_size(self) -> float:
        """Natural unit of the first channel in ``fit``, expressed in the channel's unit."""
        return self.problem.natural_units().of(MEASURED[self.problem.records[0].channels[0].measures])
