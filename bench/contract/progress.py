"""Best parameters so far: what a long fit may say on its way, so that running out of time does not lose everything."""

from __future__ import annotations

from collections.abc import Callable

from bench.contract.estimate import Estimate
from bench.contract.problem import Problem

Listener = Callable[[Problem, Callable[[], Estimate]], None]
_listener: Listener | None = None


def listen(listener: Listener | None) -> None:
    """Have ``listener`` told; the harness does so in the process of a method."""
    global _listener
    _listener = listener


def report_progress(problem: Problem, estimate: Callable[[], Estimate]) -> None:
    """Report the best answer so far to a problem that ``identify`` was given; costs nothing where nobody listens.

    ``estimate`` is called only if it is wanted. A fit that is stopped at its time limit is then scored by its last
    report, with status ``timeout``. Call it as often as convenient: once an iteration, say.
    """
    if _listener is not None:
        _listener(problem, estimate)
