"""The process of a method: it gets problems and never a truth, and answers in plain numbers.

One process serves one cell, with one thread. Where a fit of several replicates goes wrong there is no answer, and each
is to be tried alone. The process that asks takes the time of a fit by its own clocks, within which a report must lie.
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
from dataclasses import dataclass, replace
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
"""Largest answer of one replicate, packed (bytes); of several together, that of their mean."""
LEAST_SHARE, SLACK_S = 0.9, 2e-3
"""A fit may report this share of the time that the process that asks sees, less the slack (s): messages take 0.1 ms,
on a busy machine some milliseconds."""
REPORT_S = 1.0
"""Shortest interval between reports of one replicate (s): a fit that is ended is scored by its last one."""
REPORT, BEGIN, END, DONE, FAILED = b"r", b"b", b"e", b"d", b"f"
"""First byte of a message: an answer so far, begin and end of a fit, all outcomes, none of replicates together."""

Fit = Callable[[Sequence[Any], Sequence[np.random.Generator]], list[Estimate]]
"""What a method's process runs, payloads and random streams to estimates: ``identify_many`` of a method."""


def reference_fit(
    name: str, pairs: Sequence[tuple[Problem, Truth]], rngs: Sequence[np.random.Generator]
) -> list[Estimate]:
    """Return the estimates of a reference row, whose payloads are pairs of problem and truth."""
    return [REFERENCES[name](problem, truth) for problem, truth in pairs]


@dataclass(frozen=True, eq=False)
class FitTask:
    """Replicates to be fitted together; ``times`` (s) are those at which their reconstructions are evaluated.

    ``fit`` is a pickled ``Fit``, which only the process that runs it rebuilds.
    """

    fit: bytes
    replicates: tuple[int, ...]
    payloads: tuple[Any, ...]
    rngs: tuple[np.random.Generator, ...]
    times: tuple[np.ndarray, ...]
    timeout_s: float

    def part(self, i: int) -> FitTask:
        """Return the task of one of the replicates alone."""
        alone = {name: getattr(self, name)[i : i + 1] for name in ("replicates", "payloads", "rngs", "times")}
        return replace(self, **alone)


def ready(children: Children, spare: Child | None, requires: Sequence[str], memory_mb: float) -> Child:
    """Return a process that has imported what its method needs, the spare one where there is one; raises Died."""
    child = spare or children.start(serve)
    child.send(pickle.dumps((tuple(requires), memory_mb)))
    child.receive(READY_S)
    return child


def answers(
    child: Child, task: bytes, n: int, timeout_s: float, memory_mb: float, on_report: Callable[[bytes], None]
) -> bytes | None:
    """Have a task of ``n`` replicates fitted; :func:`outcomes` reads what is returned.

    Args:
        child: A process that is :func:`ready`.
        task: A pickled :class:`FitTask`.
        n: Its number of replicates.
        timeout_s: Limit of one replicate (s).
        memory_mb: Limit of the process (MB).
        on_report: Gets what the fit reports on its way, packed.

    Returns:
        None where several replicates failed together.

    Raises:
        Died: Where the process ended, or did not answer within the limits.
    """

    def now() -> tuple[float, float]:
        try:
            return perf_counter(), time.clock_gettime(~child.pid << 3 | 2)  # as clock_getcpuclockid of Linux
        except OSError:  # another system: the processor time is what the process says
            return perf_counter(), 0.0

    asked = began = ended = now()
    child.send(task)
    try:
        while (message := child.receive(max(0.0, asked[0] + timeout_s * n - perf_counter()), memory_mb))[:1] != DONE:
            if message[:1] == FAILED:
                return None
            if message[:1] == REPORT:
                on_report(message[1:])
            elif message == BEGIN and began is asked:  # a method cannot begin again
                began = ended = now()
            elif message == END:
                ended = now()
    except Died as died:
        if died.reason == "timeout":
            died.message = f"stopped after the limit of {timeout_s:g} s"
        raise
    return pack((ended[0] - began[0], ended[1] - began[1], now()[0] - asked[0], message[1:]))


def outcomes(content: bytes) -> list[dict[str, Any]]:
    """Return the outcomes of :func:`answers` in plain numbers, with times that the process that asked has seen.

    Replicates that are fitted together share the time equally.
    """
    wall_s, cpu_s, total_s, packed = unpack(content)
    answered: list[dict[str, Any]] = unpack(packed)
    n = len(answered)
    for outcome in answered:
        for name, seen, longest in (("wall_s", wall_s, total_s), ("cpu_s", cpu_s, sys.float_info.max)):
            if name in outcome and not max(LEAST_SHARE * seen - SLACK_S, 0.0) <= n * float(outcome[name]) <= longest:
                outcome[name] = seen / n
    return answered


def solve(child: Child, task: FitTask, memory_mb: float) -> list[dict[str, Any]]:
    """Return the outcomes of a task, whose replicates are tried alone where they fail together; raises Died."""
    n = len(task.replicates)
    packed = answers(child, pickle.dumps(task), n, task.timeout_s, memory_mb, lambda report: None)
    if packed is not None:
        return outcomes(packed)
    return [outcome for i in range(n) for outcome in solve(child, task.part(i), memory_mb)]


def serve(connection: Connection) -> None:
    """Import what the method needs, and fit one task after another until nobody asks any more."""
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
    """Return the packed outcome of each replicate; None where there are several, and one has made all fail."""
    n = len(task.replicates)
    try:
        packed = pack(_outcomes(task, send))
        if len(packed) > n * LONGEST_ANSWER:
            raise Unscorable(f"{len(packed) // n >> 20} MB, of which at most {LONGEST_ANSWER >> 20} are taken")
        return packed
    except Exception as error:
        return None if n > 1 else pack([{"replicate": task.replicates[0], **_failure(error)}])


class Unscorable(Exception):
    """An answer against the contract."""


def _outcomes(task: FitTask, send: Callable[[bytes], None]) -> list[dict[str, Any]]:
    n = len(task.replicates)
    fit: Fit = pickle.loads(task.fit)
    before = _peak_memory_mb()
    send(BEGIN)
    wall, cpu = perf_counter(), process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        estimates = fit(task.payloads, task.rngs)
    took = {"wall_s": (perf_counter() - wall) / n, "cpu_s": (process_time() - cpu) / n}
    send(END)
    took["peak_memory_mb"] = max(_peak_memory_mb() - before, 0.0)
    if not isinstance(estimates, list | tuple) or len(estimates) != n:
        raise TypeError(f"a list of {n} Estimate objects was expected")
    for estimate in estimates:
        if not isinstance(estimate, Estimate):
            raise TypeError(f"an Estimate was expected, not {type(estimate).__name__}")
    answered = zip(task.replicates, evaluated_together(estimates, task.times), task.times, strict=True)
    return [{"replicate": i, **_answer(estimate, times), **took} for i, estimate, times in answered]


def _answer(estimate: Estimate, times: np.ndarray) -> dict[str, Any]:
    """Return the plain answer, or ``invalid``: an estimate against the contract costs its own replicate only."""
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
        message = f"it printed, or wrote to a file, more than {LONGEST_FILE >> 20} MB"
    return {"status": status.value, "message": message, "traceback": traceback_text()}


def _peak_memory_mb() -> float:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 2**20 if sys.platform == "darwin" else peak / 2**10


def _report(task: FitTask, send: Callable[[bytes], None]) -> None:
    """Have the best answer so far of each replicate sent, now and then."""
    places = {id(payload): i for i, payload in enumerate(task.payloads) if isinstance(payload, Problem)}
    last = dict.fromkeys(places.values(), time.monotonic())

    def listener(problem: Problem, estimate: Callable[[], Estimate]) -> None:
        i, now = places.get(id(problem)), time.monotonic()
        if i is not None and now - last[i] >= REPORT_S:
            last[i] = now
            send(REPORT + pack({"replicate": task.replicates[i], **_answer(estimate(), task.times[i])}))

    listen(listener)
