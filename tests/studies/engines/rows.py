"""The measurements: rows of the table with their goals, and curves of the picture."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from tests.studies import chains
from tests.studies.engines.children import MEMORY_MB

SEED = 77
"""A seed that nothing was tuned on and no table uses."""


@dataclass(frozen=True)
class Row:
    """One line of the table: what is fitted how, and how long that should take.

    ``fields`` replace those of the scenario of ``overrides``. ``goal_s`` (a fit) and ``goal_mb`` (the whole process)
    are the goals; nan where there is none. ``rounds``: processes in turn, each with up to ``repeats`` runs within
    ``budget_s``; the best run of all counts. ``warm``: whether the process has done something alike before.
    """

    name: str
    title: str
    overrides: tuple[str, ...]
    method: str = ""
    fields: Mapping[str, Any] = field(default_factory=dict)
    together: int = 1
    goal_s: float = float("nan")
    goal_mb: float = float("nan")
    rounds: int = 2
    repeats: int = 4
    budget_s: float = 4.0
    warm: bool = True

    def task(self, limit_s: float) -> dict[str, Any]:
        """Return the task for ``row.py``."""
        return {
            "kind": "fit" if self.method else "bound", "method": self.method,
            "overrides": ["method=prior", *self.overrides], "fields": dict(self.fields), "together": self.together,
            "repeats": self.repeats, "budget_s": self.budget_s, "warm": self.warm, "seed": SEED, "limit_s": limit_s,
            "memory_mb": MEMORY_MB, "modules": [],
        }  # fmt: skip


def chain_fields(n: int) -> dict[str, Any]:
    """Return the fields that make two masses the chain of n masses of :mod:`tests.studies.chains`."""
    cell = chains.scenario(n)
    names = ("parameters", "options", "initial", "duration", "samples", "dense", "forecast", "label")
    return {name: getattr(cell, name) for name in names}


LONG = ("system=sdof", "system.samples=100000")
CHAIN = ("system=chain2", "snr=30")


def rows() -> dict[str, Row]:
    """All rows by name, in the order of the table."""
    sdof = ("system=sdof",)
    one_long: dict[str, Any] = {"rounds": 1, "repeats": 3, "budget_s": 10.0}
    long = {**one_long, "goal_s": 2.0, "goal_mb": 1000.0}
    every = [
        Row("ml", "maximum likelihood (shooting), one mass", sdof, "shooting", {}, 100, 0.5e-3),
        Row("pencil", "matrix pencil, one mass", sdof, "matrix_pencil", {}, 100, 0.15e-3),
        Row("output_error", "output error, one mass", sdof, "output_error", {}, 100, 1e-3),
        Row("mcmc", "MCMC, one mass", sdof, "mcmc", {}, 20, 30e-3),
        Row("bound", "bound of a new linear scenario", sdof, goal_s=10e-3, repeats=20),
        Row(
            "first_bound", "first bound of a nonlinear scenario in a process, imports apart", ("system=duffing",),
            goal_s=1.0, rounds=3, repeats=1, warm=False,
        ),
        Row(
            "chain10", "ten masses, 30 parameters (shooting)", CHAIN, "shooting", chain_fields(10), 1, 3.0,
            rounds=1, repeats=3, budget_s=10.0,
        ),
        Row(
            "chain20", "twenty masses, 60 parameters (shooting)", CHAIN, "shooting", chain_fields(20), 1, 30.0,
            rounds=1, repeats=2, budget_s=20.0,
        ),
        Row("long", "one mass, 100 000 samples (shooting)", LONG, "shooting", **long),
        Row("long_spline", "one mass, 100 000 samples (collocation)", LONG, "collocation", **long),
        *(
            Row(name, f"{name} (shooting)", (f"system={name}",), "shooting", {}, 20, 10e-3, rounds=1)
            for name in ("duffing", "pendulum", "coulomb")
        ),
        Row("bouc_wen", "Bouc-Wen (MCMC)", ("system=bouc_wen",), "mcmc", {}, 1, 2.0, **one_long),
    ]  # fmt: skip
    return {row.name: row for row in every}


@dataclass(frozen=True)
class Curve:
    """One line of the picture: a method over sizes of one kind; ``more`` explains growth beyond the linear."""

    method: str
    axis: Literal["together", "samples", "masses"]
    sizes: tuple[int, ...]
    more: str = ""

    def row(self, size: int) -> Row:
        """The measurement at a size."""
        shape: dict[str, Any] = {"rounds": 1, "repeats": 3, "budget_s": 2.0}
        if self.axis == "together":
            return Row("", "", ("system=sdof",), self.method, {}, size, **shape)
        if self.axis == "samples":
            return Row("", "", ("system=sdof", f"system.samples={size}"), self.method, **shape)
        return Row("", "", CHAIN, self.method, chain_fields(size), **shape)


SAMPLES = (25, 100, 1_000, 10_000, 100_000)
STEPS = (
    "each sample takes a matrix of 2 n rows times the state and its derivatives by 3 n parameters, and the record of a "
    "longer chain, whose slowest mode is slower, has about as many times more samples"
)
WAVES = "the scan for its starts compares waves of as many frequencies as there are samples, each at every sample"
CURVES = (
    Curve("shooting", "together", (1, 3, 10, 30, 100, 300), "nothing is shared between so many replicates"),
    Curve("shooting", "samples", SAMPLES, "what one mass costs is proportional to the samples; the rest is the start"),
    Curve("mcmc", "samples", SAMPLES[:4], "each draw simulates every sample; a long record needs more steps"),
    Curve("matrix_pencil", "samples", (25, 100, 300, 600), "a singular value decomposition takes the cube of them"),
    Curve("collocation", "samples", SAMPLES, WAVES),
    Curve("shooting", "masses", chains.SIZES, STEPS),
)
