"""What a method found in measured records: values, stated intervals, residuals, and how far to trust them."""

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
    """One of several records: its file's name, what it says alone, and why it is left out of the joint answer."""

    name: str
    finding: Finding
    left_out: str = ""


@dataclass(frozen=True, eq=False)
class Finding:
    """The answer of one method to measured records.

    Attributes:
        method: What the method is called.
        measured: The records, with the system that was fitted.
        estimate: The method's own answer, maybe a failed one.
        wall_s: Time of the fit (s).
        stated: Intervals by name of the quantity.
        reasons: Reasons for caution.
        fit: The likelihood at the answer, in the problem's natural units; None without an answer.
        modes: Modes that the user may choose from.
        runs: Repeats that were answered alone; all but ``stated`` and ``reasons`` is then of the run in the middle.
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
        """The verdict."""
        return verdict(self.reasons)

    @property
    def intervals(self) -> Mapping[str, StatedInterval]:
        """The stated intervals; none of an answer that is not to be trusted."""
        return {} if self.trust is Trust.NO else self.stated

    @property
    def withdrawn(self) -> Mapping[str, StatedInterval]:
        """The intervals of an answer that is not to be trusted."""
        return self.stated if self.trust is Trust.NO else {}

    @property
    def problem(self) -> Problem:
        return self.measured.problem

    @property
    def channel_size(self) -> float:
        """The unit of the first channel in ``fit``, in the channel's own unit."""
        return self.problem.natural_units().of(MEASURED[self.problem.records[0].channels[0].measures])
