"""Best answers so far: what a long fit may say on its way, so that running out of time does not lose everything."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from bench.contract.estimate import Estimate
from bench.contract.problem import Problem

Listener = Callable[[Problem, Callable[[], Estimate]], None]
_listener: Listener | None = None


def listen(listener: Listener | None) -> None:
    """Have ``listener`` told; the harness does so in the process of a method."""
    global _listener
    _listener = listener


@contextmanager
def reported_as(
    given: Sequence[Problem], originals: Sequence[Problem], back: Sequence[Callable[[Estimate], Estimate]]
) -> Iterator[None]:
    """Pass reports on the problems ``given`` to a method on as ones on their originals, converted by ``back``."""
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
    """Report the best answer so far to a problem that a method was given; costs nothing where nobody listens.

    A fit that is stopped at its time limit is scored by its last report, with status ``timeout``. Call it as often as
    convenient: once an iteration, say.

    Args:
        problem: The object that the method was given, not a copy.
        estimate: Makes the answer, in the problem's units; called only if it is wanted.
    """
    if _listener is not None:
        _listener(problem, estimate)
