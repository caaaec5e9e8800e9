"""Intermediate estimates of a running fit, which are scored if the fit exceeds its time limit."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from bench.contract.estimate import Estimate
from bench.contract.problem import Problem

Listener = Callable[[Problem, Callable[[], Estimate]], None]
_listener: Listener | None = None


def listen(listener: Listener | None) -> None:
    """Set the function that receives reports; the benchmark does so in the process of a method."""
    global _listener
    _listener = listener


@contextmanager
def reported_as(
    given: Sequence[Problem], originals: Sequence[Problem], back: Sequence[Callable[[Estimate], Estimate]]
) -> Iterator[None]:
    """Translate reports on converted problems into reports on the original problems.

    Args:
        given: Problems in the units of the method.
        originals: The same problems in the user's units.
        back: For each problem, the conversion of an estimate to the user's units.

    Yields:
        None; reports are translated within the context.
    """
    global _listener
    outer = _listener
    places = {id(problem): i for i, problem in enumerate(given)}

    def listener(problem: Problem, estimate: Callable[[], Estimate]) -> None:
        assert outer is not None
        i = places.get(id(problem))
        if i is not None:
            outer(originals[i], lambda: back[i](estimate()))

    _listener = listener if outer is not None else None
    try:
        yield
    finally:
        _listener = outer


def report_progress(problem: Problem, estimate: Callable[[], Estimate]) -> None:
    """Report the best estimate so far, for instance once per iteration.

    A fit that is stopped at its time limit is scored by its last report, with status ``timeout``.

    Args:
        problem: The problem object that the method was given, not a copy.
        estimate: Function that returns the estimate in the units of the problem; called only when needed.
    """
    if _listener is not None:
        _listener(problem, estimate)
