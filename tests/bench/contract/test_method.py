"""What Identifier does for every method: refusals, units in and out, offsets, reports of progress, failures."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import pytest

from bench import (
    Card,
    Channel,
    Cost,
    Dimension,
    Draws,
    Estimate,
    Force,
    Identifier,
    InitialState,
    NoEstimate,
    Normal,
    Problem,
    Record,
    Scope,
    Status,
    report_progress,
)
from bench.contract.progress import listen
from bench.systems import SDOF

TIMES = np.linspace(0.0, 5.0, 21)
CARD = Card("a test", "not used", "native", "own", "none", "none")


def record(scale: float = 1.0, constant: float = 0.0) -> Record:
    """A displacement about a constant and an acceleration, under a force of 3 N."""
    force = Force(np.array([0.0, 5.0]), np.array([3.0, 3.0]))
    wave = scale * np.cos(4.0 * TIMES)
    return Record(
        (Channel(TIMES, wave + constant, offset=True), Channel(TIMES, -16.0 * wave, "acceleration")), (force,)
    )


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


@dataclass(frozen=True)
class Reader(Identifier):
    """Reads an answer off the problem that it is given, which is of the problem's units by construction."""

    card = CARD
    scope = Scope(measures=("displacement", "acceleration"), several_channels=True, offsets=True)

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        own = problem.records[0]
        push, span = own.forces[0].values[0], own.duration
        x, a = (channel.values for channel in own.channels)
        mass = push / np.max(np.abs(a))  # kg where newtons and metres are given
        found = Estimate(
            problem.system,
            parameters=Draws(("m", "c", "k"), np.array([[mass, mass / span, mass / span**2]])),
            reconstructions=(lambda t: np.interp(t, own.channels[0].times, x)[None],),
            initial_states=(InitialState(x[:1], x[:1] / span),),
            offsets=(float(np.mean(x)), float(np.mean(a))),
            traces={"path": np.array([[x[0], a[0]]]), "count": np.array([7.0])},
            dimensions={"path": [Dimension(length=1.0), Dimension(length=1.0, time=-2.0)]},
        )
        report_progress(problem, lambda: found)
        return found


@dataclass(frozen=True)
class NaturalReader(Reader):
    """The same in natural units."""

    works_in = "natural units"


@pytest.fixture
def heard() -> Iterator[list[tuple[Problem, Estimate]]]:
    """What is reported while a test runs."""
    reports: list[tuple[Problem, Estimate]] = []
    listen(lambda problem, estimate: reports.append((problem, estimate())))
    yield reports
    listen(None)


def numbers(estimate: Estimate) -> dict[str, np.ndarray]:
    """Every number of an estimate that depends on the units."""
    assert isinstance(estimate.parameters, Draws)
    return {
        "draws": estimate.parameters.samples,
        "response": estimate.reconstructions[0](np.array([0.3, 1.7])),
        "start": np.concatenate([estimate.initial_states[0].displacement, estimate.initial_states[0].velocity]),
        "offsets": np.array(estimate.offsets),
        **estimate.traces,
    }


def test_an_answer_in_natural_units_comes_back_in_those_of_the_problem(heard: list[tuple[Problem, Estimate]]) -> None:
    """Reading a problem and converting is converting and reading: draws, response, start, offsets, traces, reports."""
    problem = Problem(SDOF(), (record(scale=40.0, constant=15.0),))
    plain, natural = Reader().identify(problem, rng()), NaturalReader().identify(problem, rng())
    for estimate in (natural, heard[1][1]):
        assert estimate.system == problem.system
        for name, expected in numbers(plain).items():
            np.testing.assert_allclose(numbers(estimate)[name], expected, rtol=1e-12, err_msg=name)
    assert [reported is problem for reported, _ in heard] == [True, True]
    assert plain.offsets == (
        np.mean(problem.records[0].channels[0].values),
        np.mean(problem.records[0].channels[1].values),
    )


def test_a_method_gets_the_very_problem_unless_it_asks_for_natural_units() -> None:
    problem, seen = Problem(SDOF(), (record(scale=40.0),)), []

    class Looks(Reader):
        def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
            seen.append(problem)
            return super().estimate(problem, rng)

    class LooksNaturally(Looks):
        works_in = "natural units"

    Looks().identify(problem, rng())
    LooksNaturally().identify(problem, rng())
    assert seen[0] is problem
    sizes = [np.sqrt(np.mean(c.values**2)) for c in seen[1].records[0].channels]
    assert max(sizes) == pytest.approx(1.0)
    assert seen[1].records[0].duration == pytest.approx(1.0)


class NeverAsked(Reader):
    """Must not be given a problem."""

    scope = Scope(measures=("displacement", "acceleration"), several_channels=True, offsets=True, forced=False)

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        raise AssertionError("it is never asked")


def test_what_it_objects_to_and_what_does_not_move_is_answered_without_it() -> None:
    """An unknown constant alone is no motion; where no constant is unknown, it is."""
    forced = Problem(SDOF(), (record(),))
    unforced = record(scale=0.0, constant=0.4)
    still = Problem(SDOF(), (Record(unforced.channels),))
    refused, silent = NeverAsked().identify_many([forced, still], [rng(), rng()])
    assert (refused.status, refused.message) == (Status.UNSUPPORTED, "it cannot use a known force")
    assert (silent.status, len(silent.message.split()) > 4) == (Status.DIVERGED, True)
    moved = Problem(SDOF(), (Record((Channel(TIMES, np.full(21, 0.4)),)),))
    with pytest.raises(AssertionError, match="never asked"):
        NeverAsked().identify(moved, rng())


@pytest.mark.parametrize(
    ("error", "expected"),
    [
        (lambda: NoEstimate("take more samples"), (Status.DIVERGED, "take more samples", Cost())),
        (
            lambda: NoEstimate("not a number", Status.NONFINITE, Cost(3, 4)),
            (Status.NONFINITE, "not a number", Cost(3, 4)),
        ),
    ],
)
def test_a_failure_that_is_raised_is_an_answer(
    error: Callable[[], NoEstimate], expected: tuple[Status, str, Cost]
) -> None:
    class Fails(NaturalReader):
        def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
            raise error()

    problem = Problem(SDOF(), (record(),))
    found = Fails().identify(problem, rng())
    assert (found.status, found.message, found.cost) == expected
    assert found.system == problem.system


def test_overflow_on_the_way_is_no_warning() -> None:
    """Tests raise warnings as errors."""

    class Overflows(Reader):
        def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
            groups = Normal(("k_over_m", "c_over_m"), np.exp(np.array([1e9, 1.0])), None, log=False)
            return Estimate(problem.system, groups=groups)

    found = Overflows().identify(Problem(SDOF(), (record(),)), rng())
    assert found.checked().status is Status.NONFINITE
