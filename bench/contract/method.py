"""The contract of a method: settings as typed fields, one function to write, and a card that says what it is told."""

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
    """A value of a setting that stands in a table as a row of its own: its name, where it is from, its package.

    ``supplier``: the class of another package that the value stands for, as ``module:class`` (none: the method itself
    does what the value says); ``version``: that class's, raised where a change of it alters results.
    """

    title: str
    source: str
    package: str = ""
    supplier: str = ""
    version: int = 1


@dataclass(frozen=True)
class Card:
    """What a reader must know of a method before comparing it, and how tables, figures and the page show it.

    ``scale`` says whether it works on all parameters with the prior (``native``) or returns identifiable groups only.

    What follows ``tuning`` may be left out. ``title``: its name for people (else its registered name). ``order``:
    its place in tables and legends, lowest first (else behind those that have one, by name). ``paper``: the method
    of the paper that it stands beside, as ``bench/data/paper_tables.csv`` calls it. ``states_terms``: the messages
    of its estimates name the terms of the equation of motion that it found, after ``terms kept of N:``.
    ``remarks``: its messages say how a fit ended, where those of others are warnings. ``variants``: by the name of
    a file of ``conf/method`` that starts from this method, the fields of the card that differ for it. ``choices``:
    by setting and value, what the values of a setting are called that a table compares.
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
        """The card of a variant: this one with the fields that differ."""
        return replace(self, variants={}, **self.variants[name])


@dataclass(frozen=True)
class Scope:
    """What problems a method can take; anything else becomes a row with status ``unsupported`` and a sentence."""

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
"""What a method serves that takes any problem: one that simulates, or enforces, the whole equation of motion."""


class Identifier(ABC):
    """A method: a frozen dataclass whose fields are its settings. Subclass it, write ``estimate``, register it.

    Register by an entry point in the group ``bench.methods``; that alone makes ``method=<name>`` work. A method
    imports heavy packages inside ``estimate``, names them in ``requires``, and the extra that brings them in ``extra``.
    Raise ``version`` where a change of the method alters its results: stored cells of another version are stale.
    ``works_in``: the units of the problems that ``estimate`` gets, the user's own or :meth:`Problem.natural_units`.

    Call ``identify``; it does what every method needs: it answers a problem that the method objects to, or in which no
    sensor shows any motion, by itself; converts to the units that the method works in, and its answer, its offsets and
    its reports of progress back; silences numpy's warnings of overflow and the like; and makes an answer of a
    :class:`NoEstimate`.
    """

    version: ClassVar[int] = 1
    card: ClassVar[Card]
    scope: ClassVar[Scope] = Scope()
    requires: ClassVar[tuple[str, ...]] = ()
    extra: ClassVar[str] = ""
    works_in: ClassVar[Literal["given units", "natural units"]] = "given units"

    @property
    def problems_at_once(self) -> int:
        """How many problems :meth:`identify_many` solves together, where that depends on a setting.

        A sweep hands out so many at a time; 1: as it likes, in small numbers.
        """
        return 1

    @abstractmethod
    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Write this: the answer to one problem, in its units.

        Args:
            problem: What is measured and told; read-only.
            rng: The only source of randomness.

        Raises:
            NoEstimate: A fit that went wrong, with a sentence; an Estimate with a status is as good. Any other
                exception is a bug of the method, and becomes a row with status ``crashed``.
        """

    def estimate_many(self, problems: Sequence[Problem], rngs: Sequence[np.random.Generator]) -> list[Estimate]:
        """Answer the problems, in order. Override where many can be done faster than one by one.

        An estimate must not depend on which other problems it is solved with.
        """
        return [self._estimate_or_failure(problem, rng) for problem, rng in zip(problems, rngs, strict=True)]

    def _estimate_or_failure(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        try:
            return self.estimate(problem, rng)
        except NoEstimate as reason:
            return Estimate.failed(problem.system, reason.status, str(reason), reason.cost)

    def completed(self, problems: Sequence[Problem], estimates: Sequence[Estimate]) -> list[Estimate]:
        """Add what all methods of a kind say of their answers, in the user's units; nothing by default."""
        return list(estimates)

    @final
    def identify(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Answer one problem, in its units; see the class."""
        return self.identify_many([problem], [rng])[0]

    @final
    def identify_many(self, problems: Sequence[Problem], rngs: Sequence[np.random.Generator]) -> list[Estimate]:
        """Answer the problems, in order, each in its units and as it would be alone; see the class."""
        refused = [self._refusal(problem) for problem in problems]
        taken = [(problem, rng) for problem, rng, no in zip(problems, rngs, refused, strict=True) if no is None]
        originals, own_rngs = [problem for problem, _ in taken], [rng for _, rng in taken]
        natural = self.works_in == "natural units"
        units = [problem.natural_units() if natural else Units() for problem in originals]
        given = [p.expressed_in(u) if natural else p for p, u in zip(originals, units, strict=True)]

        def back(i: int, estimate: Estimate) -> Estimate:
            return estimate.returned(originals[i], units[i]) if natural else estimate

        with reported_as(given, originals, [partial(back, i) for i in range(len(given))]), np.errstate(all="ignore"):
            found = self.estimate_many(given, own_rngs) if given else []
            answers = iter(self.completed(originals, [back(i, estimate) for i, estimate in enumerate(found)]))
        return [next(answers) if no is None else no for no in refused]

    def _refusal(self, problem: Problem) -> Estimate | None:
        objection = self.objection(problem)
        if objection is not None:
            return Estimate.failed(problem.system, Status.UNSUPPORTED, objection)
        return Estimate.failed(problem.system, Status.DIVERGED, SILENT) if problem.silent else None

    def objection(self, problem: Problem) -> str | None:
        """Why this method cannot take the problem, in a sentence; None where it can."""
        s, system = self.scope, problem.system
        channels = [channel for record in problem.records for channel in record.channels]
        unmeasured = {c.measures for c in channels} - set(s.measures)
        checks = {
            f"it cannot use measured {', '.join(sorted(unmeasured))}": bool(unmeasured),
            "it takes one record": len(problem.records) > 1 and not s.several_records,
            "it takes one channel a record": any(len(r.channels) > 1 for r in problem.records)
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
