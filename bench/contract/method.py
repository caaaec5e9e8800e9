"""Interface of identification methods: settings as typed fields, one function to implement, and a card."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, ClassVar, Literal, final

import numpy as np

from bench.contract.estimate import Estimate, NoEstimate, Status
from bench.contract.problem import Measures, Problem, Units
from bench.contract.progress import reported_as

SILENT = "no sensor shows any motion; check the wiring or choose another record"


@dataclass(frozen=True)
class Choice:
    """A value of a setting that is a row of a table.

    Attributes:
        title: Name in the table.
        source: Publication.
        package: Package that provides the value; empty for the method itself.
        supplier: Class of another package that the value selects, as ``module:class``; empty for the method itself.
        version: Version of that class, to be raised when a change of it alters results.
    """

    title: str
    source: str
    package: str = ""
    supplier: str = ""
    version: int = 1


@dataclass(frozen=True)
class Card:
    """Description of a method for readers, tables and figures. The fields after ``settings_source`` are optional.

    Attributes:
        summary: What the method does, in one sentence.
        start: How the method uses the initial state of a record.
        scale: ``native`` if it estimates all parameters with the prior, ``groups`` if identifiable groups only.
        reconstruction: ``own`` if it returns the displacement, ``simulated`` if the benchmark simulates it.
        uncertainty: How intervals are computed.
        settings_source: Origin of the default settings.
        tuning: Data on which settings were chosen, and number of trials.
        title: Name in tables and figures; by default the registered name.
        order: Position in tables and legends, lowest first; ties are sorted by name.
        paper: Method of the paper to compare with, as named in ``bench/data/paper_tables.csv``.
        states_terms: True if messages of estimates list the selected terms of the equation of motion after
            ``terms kept of N:``.
        remarks: True if messages of estimates describe how the fit ended; otherwise they are warnings.
        variants: For each file of ``conf/method`` based on this method, by name, the fields that differ.
        choices: For each setting, by value, the description of values that a table compares.
    """

    summary: str
    start: Literal["used when known", "estimated always", "not used"]
    scale: Literal["native", "groups"]
    reconstruction: Literal["own", "simulated"]
    uncertainty: str
    settings_source: str
    tuning: str = "none"
    title: str = ""
    order: int = 1000
    paper: str = ""
    states_terms: bool = False
    remarks: bool = False
    variants: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    choices: Mapping[str, Mapping[str, Choice]] = field(default_factory=dict)

    def variant(self, name: str) -> Card:
        """Return the card of a variant."""
        return replace(self, variants={}, **self.variants[name])


@dataclass(frozen=True)
class Scope:
    """Problems that a method can solve; others give a row with status ``unsupported`` and the reason.

    Attributes:
        measures: Quantities that it can use.
        several_records: True if it can use several records.
        several_channels: True if it can use several channels per record.
        offsets: True if it can estimate unknown sensor offsets.
        forced: True if it can use known forces.
        max_dof: Largest number of degrees of freedom; None for no limit.
        nonlinear: True if it can identify nonlinear systems.
        hidden_states: True if it can identify systems with hidden states.
        free_without_prior: True if it can identify the groups from free vibration without a prior.
        added_mass: True if it can use known added masses.
    """

    measures: tuple[Measures, ...] = ("displacement",)
    several_records: bool = False
    several_channels: bool = False
    offsets: bool = False
    forced: bool = True
    max_dof: int | None = 1
    nonlinear: bool = True
    hidden_states: bool = False
    free_without_prior: bool = True
    added_mass: bool = False


EVERY_PROBLEM = Scope(
    measures=("displacement", "velocity", "acceleration"),
    several_records=True,
    several_channels=True,
    offsets=True,
    max_dof=None,
    hidden_states=True,
    added_mass=True,
)
"""Scope of methods that simulate or enforce the whole equation of motion: any problem."""


class Identifier(ABC):
    """Base class of methods: a frozen dataclass whose fields are the settings. Subclasses implement ``estimate``.

    Register a method by an entry point in the group ``bench.methods``; then ``method=<name>`` works. Import large
    packages inside ``estimate``, and name them in ``requires`` and the extra that installs them in ``extra``.
    ``works_in`` selects the units of the problems given to ``estimate``: the user's or :meth:`Problem.natural_units`.

    Raise ``version`` when a change of the method alters its results, or a number of ``parts`` when it alters only those
    under a condition (:data:`bench.store.version.CONDITIONS`); stored cells of another version are stale.

    Callers use ``identify``, which rejects problems outside the scope and records without motion, converts problems,
    estimates and progress reports between units, suppresses NumPy's floating-point warnings, and converts a
    :class:`NoEstimate` to a failed estimate.
    """

    version: ClassVar[int] = 1
    parts: ClassVar[Mapping[str, int]] = {}
    card: ClassVar[Card]
    scope: ClassVar[Scope] = Scope()
    requires: ClassVar[tuple[str, ...]] = ()
    extra: ClassVar[str] = ""
    works_in: ClassVar[Literal["given units", "natural units"]] = "given units"

    @property
    def problems_at_once(self) -> int:
        """Number of problems that a sweep passes to :meth:`identify_many` at a time; 1 for no preference."""
        return 1

    @abstractmethod
    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Solve one problem (to be implemented).

        Args:
            problem: The problem, read-only.
            rng: The only source of randomness.

        Returns:
            The estimate in the units of the problem. A failure may be returned as an estimate with a status.

        Raises:
            NoEstimate: If the fit failed. Any other exception counts as an error of the method (status ``crashed``).
        """

    def estimate_many(self, problems: Sequence[Problem], rngs: Sequence[np.random.Generator]) -> list[Estimate]:
        """Solve several problems; to be overridden where a batch is faster.

        The estimate of a problem must not depend on the other problems.

        Args:
            problems: The problems.
            rngs: One random generator per problem.

        Returns:
            One estimate per problem, in order.
        """
        return [self._estimate_or_failure(problem, rng) for problem, rng in zip(problems, rngs, strict=True)]

    def _estimate_or_failure(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        try:
            return self.estimate(problem, rng)
        except NoEstimate as reason:
            return Estimate.failed(problem.system, reason.status, str(reason), reason.cost)

    def completed(self, problems: Sequence[Problem], estimates: Sequence[Estimate]) -> list[Estimate]:
        """Complete estimates in the user's units, for instance by messages; returns them unchanged by default.

        Args:
            problems: The problems in the user's units.
            estimates: One estimate per problem.

        Returns:
            The completed estimates, in order.
        """
        return list(estimates)

    @final
    def identify(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Solve one problem, with the checks and conversions described for the class.

        Args:
            problem: The problem.
            rng: The only source of randomness.

        Returns:
            The estimate in the units of the problem.
        """
        return self.identify_many([problem], [rng])[0]

    @final
    def identify_many(self, problems: Sequence[Problem], rngs: Sequence[np.random.Generator]) -> list[Estimate]:
        """Solve several problems, with the checks and conversions described for the class.

        Args:
            problems: The problems.
            rngs: One random generator per problem.

        Returns:
            One estimate per problem, in order and in its units; each is the same as if solved alone.
        """
        refused = [self._refusal(problem) for problem in problems]
        accepted = [(problem, rng) for problem, rng, no in zip(problems, rngs, refused, strict=True) if no is None]
        originals, generators = [problem for problem, _ in accepted], [rng for _, rng in accepted]
        natural = self.works_in == "natural units"
        units = [problem.natural_units() if natural else Units() for problem in originals]
        given = [p.expressed_in(u) if natural else p for p, u in zip(originals, units, strict=True)]

        def back(i: int, estimate: Estimate) -> Estimate:
            return estimate.returned(originals[i], units[i]) if natural else estimate

        with reported_as(given, originals, [partial(back, i) for i in range(len(given))]), np.errstate(all="ignore"):
            estimates = self.estimate_many(given, generators) if given else []
            completed = iter(self.completed(originals, [back(i, estimate) for i, estimate in enumerate(estimates)]))
        return [next(completed) if no is None else no for no in refused]

    def _refusal(self, problem: Problem) -> Estimate | None:
        objection = self.objection(problem)
        if objection is not None:
            return Estimate.failed(problem.system, Status.UNSUPPORTED, objection)
        return Estimate.failed(problem.system, Status.DIVERGED, SILENT) if problem.silent else None

    def objection(self, problem: Problem) -> str | None:
        """Return the reason why the method cannot solve the problem, in one sentence; None if it can."""
        s, system = self.scope, problem.system
        channels = [channel for record in problem.records for channel in record.channels]
        unmeasured = {c.measures for c in channels} - set(s.measures)
        checks = {
            f"it cannot use measured {', '.join(sorted(unmeasured))}": bool(unmeasured),
            "it takes one record": len(problem.records) > 1 and not s.several_records,
            "it takes one channel per record": any(len(r.channels) > 1 for r in problem.records)
            and not s.several_channels,
            "it cannot estimate a sensor's offset": any(c.offset for c in channels) and not s.offsets,
            "it cannot use a known force": problem.forced and not s.forced,
            f"it takes at most {s.max_dof} DOF": s.max_dof is not None and system.n_dof > s.max_dof,
            "it needs a linear system": not system.linear and not s.nonlinear,
            "it cannot use a known added mass": any(r.added_mass is not None for r in problem.records)
            and not s.added_mass,
            "it cannot estimate hidden states": system.n_hidden > 0 and not s.hidden_states,
        }
        return next((sentence for sentence, applies in checks.items() if applies), None)
