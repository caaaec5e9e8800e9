"""The process of a method: it receives problems, never true values, and returns plain numbers.

A process serves one cell, with one thread. If a fit of several replicates fails, they are repeated one by one. The
parent process measures the time of a fit with its own clocks, and accepts a time reported by the child only within
them.
"""

from __future__ import annotations

import contextlib
import errno
import importlib
import pickle
import resource
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from time import perf_counter, process_time
from typing import Any

import numpy as np

from bench.contract.estimate import Estimate, Status
from bench.contract.problem import Problem
from bench.contract.progress import listen
from bench.engine.wire import evaluated_together, pack, plain, unpack
from bench.entrants.reference import REFERENCES
from bench.isolation.failure import one_line, traceback_text
from bench.isolation.limits import LONGEST_FILE, limit_files, limit_memory, limit_processor_time
from bench.isolation.processes import READY_S, Child, Children, Died
from bench.scenario.truth import Truth

CPU_MARGIN_S = 60.0
LONGEST_ANSWER = 64 << 20
"""Largest mean size of a packed answer per replicate (bytes)."""
LEAST_SHARE, SLACK_S = 0.9, 2e-3
"""The smallest time that a fit may report: this share of the time seen by the parent, less the slack (s). A message
takes 0.1 ms, or some milliseconds on a busy machine."""
REPORT_S = 1.0
"""Shortest interval between reports of one replicate (s); a fit that is stopped is scored by its last report."""
REPORT, BEGIN, END, DONE, FAILED = b"r", b"b", b"e", b"d", b"f"
"""First byte of a message: intermediate estimate, begin and end of the fit, outcomes, failure of several replicates."""

Fit = Callable[[Sequence[Any], Sequence[np.random.Generator]], list[Estimate]]
"""The function that a method's process calls, such as ``identify_many``: payloads and random generators to
estimates."""


def reference_fit(
    name: str, pairs: Sequence[tuple[Problem, Truth]], rngs: Sequence[np.random.Generator]
) -> list[Estimate]:
    """Return the estimates of a reference, whose payloads are pairs of problem and truth."""
    return [REFERENCES[name](problem, truth) for problem, truth in pairs]


@dataclass(frozen=True, eq=False)
class FitTask:
    """Replicates to be fitted together.

    ``fit`` is a pickled :data:`Fit`, which only the method's process unpickles; ``times`` (s) are those at which the
    reconstructions are evaluated.
    """

    fit: bytes
    replicates: tuple[int, ...]
    payloads: tuple[Any, ...]
    rngs: tuple[np.random.Generator, ...]
    times: tuple[np.ndarray, ...]
    timeout_s: float


def ready(children: Children, spare: Child | None, requires: Sequence[str], memory_mb: float) -> Child:
    """Return a process that has imported the packages of its method; a spare process is used if given. Raises Died."""
    child = spare or children.start(serve)
    child.send(pickle.dumps((tuple(requires), memory_mb)))
    child.receive(READY_S)
    return child


def answers(
    child: Child, task: bytes, n: int, timeout_s: float, memory_mb: float, on_report: Callable[[bytes], None]
) -> bytes | None:
    """Run a task in a method's process.

    Args:
        child: A process from :func:`ready`.
        task: A pickled :class:`FitTask`.
        n: Its number of replicates.
        timeout_s: Time limit per replicate, s.
        memory_mb: Memory limit of the process, MB.
        on_report: Called with each packed intermediate estimate.

    Returns:
        The packed outcomes, for :func:`outcomes`; None if several replicates failed together.

    Raises:
        Died: The process ended, or exceeded a limit.
    """

    def now() -> tuple[float, float]:
        try:
            return perf_counter(), time.clock_gettime(~child.pid << 3 | 2)  # as clock_getcpuclockid of Linux
        except OSError:  # not Linux: the processor time reported by the child is used
            return perf_counter(), 0.0

    sent = began = ended = now()
    child.send(task)
    try:
        while (message := child.receive(max(0.0, sent[0] + timeout_s * n - perf_counter()), memory_mb))[:1] != DONE:
            if message[:1] == FAILED:
                return None
            if message[:1] == REPORT:
                on_report(message[1:])
            elif message == BEGIN and began is sent:  # a method cannot restart the clock
                began = ended = now()
            elif message == END:
                ended = now()
    except Died as died:
        if died.reason == "timeout":
            died.message = f"stopped after the limit of {timeout_s:g} s"
        raise
    return pack((ended[0] - began[0], ended[1] - began[1], now()[0] - sent[0], message[1:]))


def outcomes(content: bytes) -> list[dict[str, Any]]:
    """Unpack the outcomes of :func:`answers`; times that contradict the parent's clocks are replaced.

    Replicates that were fitted together share the time equally.
    """
    wall_s, cpu_s, total_s, packed = unpack(content)
    answered: list[dict[str, Any]] = unpack(packed)
    n = len(answered)
    for outcome in answered:
        for name, measured, longest in (("wall_s", wall_s, total_s), ("cpu_s", cpu_s, sys.float_info.max)):
            least = max(LEAST_SHARE * measured - SLACK_S, 0.0)
            if name in outcome and not least <= n * float(outcome[name]) <= longest:
                outcome[name] = measured / n
    return answered


def solve(child: Child, task: FitTask, memory_mb: float) -> dict[str, Any]:
    """Return the outcome of a task of one replicate; raises Died."""
    packed = answers(child, pickle.dumps(task), 1, task.timeout_s, memory_mb, lambda report: None)
    assert packed is not None  # several replicates can fail together
    return outcomes(packed)[0]


def serve(connection: Connection) -> None:
    """Import the packages of the method, then fit tasks until the connection is closed."""
    requires, memory_mb = pickle.loads(connection.recv_bytes())
    for package in requires:  # imported before the clock runs
        with contextlib.suppress(ImportError):
            importlib.import_module(package)
    limit_memory(memory_mb)
    limit_files()
    connection.send_bytes(b"ready")
    while True:
        task: FitTask = pickle.loads(connection.recv_bytes())
        limit_processor_time(task.timeout_s * len(task.replicates) + CPU_MARGIN_S)
        _report(task, connection.send_bytes)
        packed = perform(task, connection.send_bytes)
        connection.send_bytes(FAILED if packed is None else DONE + packed)


def perform(task: FitTask, send: Callable[[bytes], None] = lambda message: None) -> bytes | None:
    """Return the packed outcomes of a task; None if several replicates failed together."""
    n = len(task.replicates)
    try:
        packed = pack(_outcomes(task, send))
        if len(packed) > n * LONGEST_ANSWER:
            raise Unscorable(f"its size of {len(packed) // n >> 20} MB exceeds the limit of {LONGEST_ANSWER >> 20} MB")
        return packed
    except Exception as error:
        return None if n > 1 else pack([{"replicate": task.replicates[0], **_failure(error)}])


class Unscorable(Exception):
    """An estimate that violates the contract."""


def _outcomes(task: FitTask, send: Callable[[bytes], None]) -> list[dict[str, Any]]:
    n = len(task.replicates)
    fit: Fit = pickle.loads(task.fit)
    before = _peak_memory_mb()
    send(BEGIN)
    wall, cpu = perf_counter(), process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        estimates = fit(task.payloads, task.rngs)
    measured = {"wall_s": (perf_counter() - wall) / n, "cpu_s": (process_time() - cpu) / n}
    send(END)
    measured["peak_memory_mb"] = max(_peak_memory_mb() - before, 0.0)
    if not isinstance(estimates, list | tuple) or len(estimates) != n:
        raise TypeError(f"a list of {n} Estimate objects was expected")
    for estimate in estimates:
        if not isinstance(estimate, Estimate):
            raise TypeError(f"an Estimate was expected, not {type(estimate).__name__}")
    answered = zip(task.replicates, evaluated_together(estimates, task.times), task.times, strict=True)
    return [{"replicate": i, **_answer(estimate, times), **measured} for i, estimate, times in answered]


def _answer(estimate: Estimate, times: np.ndarray) -> dict[str, Any]:
    """Return the estimate in plain numbers, or its failure: an invalid estimate affects its own replicate only."""
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            return {"answer": plain(estimate, times)}
    except Exception as error:
        return _failure(Unscorable(one_line(error)))


def _failure(error: Exception) -> dict[str, Any]:
    status, message = Status.CRASHED, one_line(error)
    if isinstance(error, Unscorable):
        status, message = Status.INVALID, f"the estimate cannot be scored: {error}"
    elif isinstance(error, MemoryError):
        status, message = Status.OOM, "out of memory"
    elif isinstance(error, OSError) and error.errno == errno.EFBIG:
        message = f"printed, or wrote to a file, more than {LONGEST_FILE >> 20} MB"
    return {"status": status.value, "message": message, "traceback": traceback_text()}


def _peak_memory_mb() -> float:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 2**20 if sys.platform == "darwin" else peak / 2**10


def _report(task: FitTask, send: Callable[[bytes], None]) -> None:
    """Register a listener that sends the intermediate estimate of each replicate at most once per :data:`REPORT_S`."""
    indices = {id(payload): i for i, payload in enumerate(task.payloads) if isinstance(payload, Problem)}
    last = dict.fromkeys(indices.values(), time.monotonic())

    def listener(problem: Problem, estimate: Callable[[], Estimate]) -> None:
        i, now = indices.get(id(problem)), time.monotonic()
        if i is not None and now - last[i] >= REPORT_S:
            last[i] = now
            send(REPORT + pack({"replicate": task.replicates[i], **_answer(estimate(), task.times[i])}))

    listen(listener)
