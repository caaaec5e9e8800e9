"""The contract of a method: settings as typed fields, one function to write, and a card that says what it is told."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Literal

import numpy as np

from bench.contract.estimate import Estimate
from bench.contract.problem import Measures, Problem


@dataclass(frozen=True)
class Card:
    """What a reader must know of a method before comparing it, and how tables, figures and the page show it.

    ``scale`` says whether it works on all parameters with the prior (``native``) or returns identifiable groups only.

    What follows ``tuning`` may be left out. ``title``: its name for people (else its registered name). ``order``: its
    place in tables and legends, lowest first (else behind those that have one, by name). ``colour`` (``#rrggbb``) and
    ``marker`` (matplotlib's) of its points (else of a palette, by its name). ``paper``: the method of the paper that it
    stands beside, as ``bench/data/paper_tables.csv`` calls it. ``states_terms``: the messages of its estimates name the
    terms of the equation of motion that it found, after ``terms kept of N:``. ``variants``: by the name of a file of
    ``conf/method`` that starts from this method, the fields of the card that differ for it.
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
    colour: str = ""
    marker: str | tuple[int, int, float] = ""
    paper: str = ""
    states_terms: bool = False
    variants: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def variant(self, name: str) -> Card:
        """The card of a variant: this one with the fields that differ."""
        return replace(self, variants={}, **self.variants[name])


@dataclass(frozen=True)
class Serves:
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


class Identifier(ABC):
    """A method: a frozen dataclass whose fields are its settings. Subclass it, write ``identify``, register it.

    Register by an entry point in the group ``bench.methods``; that alone makes ``method=<name>`` work. A method
    imports heavy packages inside ``identify``, names them in ``requires``, and the extra that brings them in ``extra``.
    """

    card: ClassVar[Card]
    serves: ClassVar[Serves] = Serves()
    requires: ClassVar[tuple[str, ...]] = ()
    extra: ClassVar[str] = ""

    @abstractmethod
    def identify(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """The estimate for one problem. Randomness comes from ``rng`` alone; the problem is read-only.

        A fit that goes wrong is an Estimate with a status and a sentence; an exception is a bug of the method,
        and becomes a row with status ``crashed``.
        """

    def identify_many(self, problems: Sequence[Problem], rngs: Sequence[np.random.Generator]) -> list[Estimate]:
        """One estimate a problem, in order. Override where many can be done faster than one by one.

        An estimate must not depend on which other problems it is solved with.
        """
        return [self.identify(problem, rng) for problem, rng in zip(problems, rngs, strict=True)]

    def objection(self, problem: Problem) -> str | None:
        """Why this method cannot take the problem, in a sentence; None where it can."""
        s, system = self.serves, problem.system
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
