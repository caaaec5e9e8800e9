"""Methods that go wrong, each in its own way, and one that spies: a worker process must be able to import them."""

from __future__ import annotations

import gc
import os
import pickle
import pickletools
import signal
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from bench import Card, Cost, Estimate, Identifier, Normal, Problem, Serves

CARD = Card("a test double", "not used", "groups", "simulated", "none", "tests")
LEAKS = ("Truth", "Scenario", "PriorSpec", "Cell", "Bound")


def answer(problem: Problem, value: float = 1.0, message: str = "") -> Estimate:
    """A well-formed estimate that says ``value`` of every group."""
    names = tuple(group.name for group in problem.system.groups)
    groups = Normal(names, np.full(len(names), value), np.eye(len(names)), log=False, dof=10)
    return Estimate(problem.system, groups=groups, message=message, cost=Cost(evaluations=7))


@dataclass(frozen=True)
class Unpicklable:
    """A reconstruction that cannot leave its process."""

    def __call__(self, times: np.ndarray) -> np.ndarray:
        return times[None]

    def __reduce__(self) -> Any:
        raise TypeError("this stays here")


def explode() -> None:
    """What unpickling a :class:`Trap` calls."""
    raise RuntimeError("unpickled")


@dataclass(frozen=True)
class Trap:
    """A reconstruction that leaves its process but cannot be rebuilt in another."""

    def __call__(self, times: np.ndarray) -> np.ndarray:
        return times[None]

    def __reduce__(self) -> Any:
        return explode, ()


@dataclass(frozen=True)
class RaisingReconstruction:
    """A reconstruction that raises when it is scored."""

    def __call__(self, times: np.ndarray) -> np.ndarray:
        raise ValueError("no reconstruction here")


def misbehave(kind: str, problem: Problem) -> Any:
    """Go wrong as ``kind`` says, or answer."""
    good = answer(problem)
    if kind == "raise":
        raise ValueError("two lines\nof reasons")
    if kind == "exit":
        os._exit(3)
    if kind == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    if kind == "sleep":
        time.sleep(600)
    if kind == "memory":
        raise MemoryError
    if kind == "type":
        return 42.0
    if kind == "nan":
        return answer(problem, float("nan"))
    if kind == "empty":
        return Estimate(problem.system)
    if kind == "unpicklable":
        return Estimate(problem.system, groups=good.groups, reconstructions=(Unpicklable(),))
    if kind == "trap":
        return Estimate(problem.system, groups=good.groups, reconstructions=(Trap(),))
    if kind == "raising_reconstruction":
        return Estimate(problem.system, groups=good.groups, reconstructions=(RaisingReconstruction(),))
    if kind == "misshapen":
        return Estimate(problem.system, groups=Normal(("k_over_m", "nonsense"), np.ones(3), None, log=False))
    if kind == "print":
        print("chatter on stdout")
    if kind == "warn":
        np.log(np.array([-1.0]))
    return good


@dataclass(frozen=True)
class FitByName:
    """A worker's fit whose payloads are pairs: how to misbehave, and the problem."""

    def __call__(self, payloads: Sequence[tuple[str, Problem]], rngs: Sequence[np.random.Generator]) -> Any:
        return [misbehave(kind, problem) for kind, problem in payloads]


@dataclass(frozen=True)
class Wrong(Identifier):
    """A registered method that goes wrong as its setting says."""

    kind: str = "raise"

    card: ClassVar[Card] = CARD
    serves: ClassVar[Serves] = Serves()

    def identify(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        return misbehave(self.kind, problem)  # type: ignore[no-any-return]


@dataclass(frozen=True)
class Draw(Identifier):
    """Answers with a number from its random stream in the message."""

    card: ClassVar[Card] = CARD
    serves: ClassVar[Serves] = Serves()

    def identify(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        return answer(problem, message=repr(float(rng.standard_normal())))


@dataclass(frozen=True)
class Spy(Identifier):
    """Looks for the truth: in what it is given, and in the whole process. Its message names what it found."""

    card: ClassVar[Card] = CARD
    serves: ClassVar[Serves] = Serves()

    def identify(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        text = " ".join(str(argument) for _, argument, _ in pickletools.genops(pickle.dumps(problem)))
        given = [leak for leak in LEAKS if leak in text]
        alive = sorted({type(o).__name__ for o in gc.get_objects()} & set(LEAKS))
        return answer(problem, message=f"given {given} alive {alive} saw {type(problem).__name__}")


@dataclass(frozen=True)
class Needy(Identifier):
    """Needs a package that nobody has."""

    card: ClassVar[Card] = CARD
    requires: ClassVar[tuple[str, ...]] = ("a_package_that_nobody_has",)
    extra: ClassVar[str] = "needy"

    def identify(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        raise AssertionError("never reached")


@dataclass(frozen=True)
class FreeOnly(Identifier):
    """Cannot use a known force."""

    card: ClassVar[Card] = CARD
    serves: ClassVar[Serves] = Serves(forced=False)

    def identify(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        return answer(problem)


@dataclass(frozen=True)
class Exact(Identifier):
    """Answers with groups given as settings: a measured record's report can then be checked."""

    k_over_m: float = 9.0
    c_over_m: float = 0.5

    card: ClassVar[Card] = CARD
    serves: ClassVar[Serves] = Serves(offsets=True)

    def identify(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        covariance = np.diag([0.04, 0.0025])
        mean = np.array([self.k_over_m, self.c_over_m])
        return Estimate(problem.system, groups=Normal(("k_over_m", "c_over_m"), mean, covariance, log=False))


class NotAMethod:
    """What a broken entry point may name."""
