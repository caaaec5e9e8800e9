"""The process of a method: it gets problems and never a truth, and answers in plain numbers.

One process serves one cell, with one thread. What goes wrong in a fit of several replicates is tried again one by one.
The process that asks watches each attempt by its own clocks, within which the times that a fit reports must lie.
"""

from __future__ import annotations

import contextlib
import errno
import importlib
import os
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
from bench.entrants.reference import REFERENCES
from bench.isolation.failure import one_line, traceback_text
from bench.isolation.limit import LONGEST_FILE, limit_files
from bench.isolation.processes import READY_S, Child, Children, Died
from bench.scenario.truth import Truth
from bench.sweep.wire import evaluated_together, pack, plain, unpack

CPU_MARGIN_S = 60.0
LONGEST_ANSWER = 64 << 20
"""Largest answer of one replicate, packed (bytes)."""
LEAST_SHARE, SLACK_S = 0.9, 2e-3
"""An attempt may report this share of the time that the process that asks sees, less the slack (s): messages take
0.1 ms, on a busy machine some milliseconds."""
REPORT, BEGIN, END, DONE = b"r", b"b", b"e", b"d"
"""First byte of a message from a method's process: an answer so far, begin and end of an attempt, all outcomes."""


Fit = Callable[[Sequence[Any], Sequence[np.random.Generator]], list[Estimate]]
"""What a method's process runs, payloads and random streams to estimates: ``identify_many`` of a method."""


def reference_fit(
    name: str, pairs: Sequence[tuple[Problem, Truth]], rngs: Sequence[np.random.Generator]
) -> list[Estimate]:
    """Return the estimates of a reference row, whose payloads are pairs of problem and truth."""
    return [REFERENCES[name](problem, truth) for problem, truth in pairs]


@dataclass(frozen=True, eq=False)
class Task:
    """Replicates to be fitted together; ``times`` (s) are those at which their reconstructions are evaluated.

    ``fit`` is a pickled ``Fit``, which only the process that runs it rebuilds.
    """

    fit: bytes
    replicates: tuple[int, ...]
    payloads: tuple[Any, ...]
    rngs: tuple[np.random.Generator, ...]
    times: tuple[np.ndarray, ...]
    timeout_s: float

    def part(self, i: int) -> Task:
        """Return the task of one of the replicates alone."""
        alone = {name: getattr(self, name)[i : i + 1] for name in ("replicates", "payloads", "rngs", "times")}
        return replace(self, **alone)


def serve(connection: Connection) -> None:
    """Import what the method needs, and fit one task after another until nobody asks any more."""
    requires, memory_mb = pickle.loads(connection.recv_bytes())
    for package in requires:  # imported before the clock runs
        with contextlib.suppress(ImportError):
            importlib.import_module(package)
    _limit_memory(memory_mb)
    limit_files()
    connection.send_bytes(b"ready")
    while True:
        content = connection.recv_bytes()
        connection.send_bytes(DONE + pack(perform(content, connection)))


def ready(children: Children, spare: Child | None, requires: Sequence[str], memory_mb: float | None) -> Child:
    """Return a process that has imported what its method needs, the spare one where there is one; raises Died."""
    child = spare or children.start(serve)
    child.send(pickle.dumps((tuple(requires), memory_mb)))
    child.receive(READY_S)
    return child


def answers(
    child: Child, task: bytes, n: int, timeout_s: float, memory_mb: float, on_report: Callable[[bytes], None]
) -> bytes:
    """Have a task of ``n`` replicates fitted; :func:`outcomes` reads what is returned.

    Args:
        child: A process that is :func:`ready`.
        task: A pickled :class:`Task`.
        n: How many replicates it has.
        timeout_s: Limit of one replicate (s).
        memory_mb: Limit of the process (MB).
        on_report: Gets what the fit reports on its way, packed.

    Raises:
        Died: Where the process ended, or did not answer within the limits.
    """
    watch = _Watch(child.pid, n)
    child.send(task)
    deadline = time.monotonic() + timeout_s * n
    try:
        while (message := child.receive(max(0.0, deadline - time.monotonic()), memory_mb))[:1] != DONE:
            if message[:1] == REPORT:
                on_report(message[1:])
            else:
                watch.note(message)
    except Died as died:
        if died.reason == "timeout":
            died.message = f"stopped after the limit of {timeout_s:g} s"
        raise
    return pack((watch.spans, watch.total_s, message[1:]))


def outcomes(content: bytes) -> list[dict[str, Any]]:
    """Return the outcomes of :func:`answers` in plain numbers, with times that the process that asked has seen.

    Replicates of one attempt share its time equally. The first attempt has them all; where it failed, each has one.
    """
    spans, total_s, packed = unpack(content)
    answered: list[dict[str, Any]] = unpack(packed)
    together = len(spans) < 2
    n = len(answered) if together else 1
    for i, outcome in enumerate(answered if spans else []):
        seen = spans[0 if together else min(i + 1, len(spans) - 1)]
        for name, span, longest in zip(("wall_s", "cpu_s"), seen, (total_s, sys.float_info.max), strict=True):
            if name in outcome and not max(LEAST_SHARE * span - SLACK_S, 0.0) <= n * float(outcome[name]) <= longest:
                outcome[name] = span / n
    return answered


class _Watch:
    """Wall and processor times (s) of the attempts of a process, by clocks that it cannot change."""

    def __init__(self, pid: int, n: int) -> None:
        self.pid, self.most = pid, n + 1
        self.spans: list[tuple[float, float]] = []
        self.began = self._begin = self._now()

    def note(self, message: bytes) -> None:
        """Note the begin of an attempt, or its end; one that fails has none."""
        now = self._now()
        if message == BEGIN and len(self.spans) < self.most:
            self.spans.append((0.0, 0.0))
            self._begin = now
        elif message == END and self.spans:
            self.spans[-1] = (now[0] - self._begin[0], now[1] - self._begin[1])

    @property
    def total_s(self) -> float:
        """Wall time since the request."""
        return self._now()[0] - self.began[0]

    def _now(self) -> tuple[float, float]:
        try:
            return perf_counter(), time.clock_gettime(~self.pid << 3 | 2)  # as clock_getcpuclockid of Linux
        except OSError:  # another system: the processor time is what the process says
            return perf_counter(), 0.0


def perform(content: bytes, connection: Connection | None = None) -> list[dict[str, Any]]:
    """Return the outcome of each replicate of a pickled task, in plain numbers."""
    task: Task = pickle.loads(content)
    _limit_processor_time(task.timeout_s * len(task.replicates) + CPU_MARGIN_S)
    if connection is not None:
        listen(_Reporter(connection, task))
    send = (lambda message: None) if connection is None else connection.send_bytes
    try:
        return _outcomes(task, send)
    except Exception:
        if len(task.replicates) == 1:
            return [_failure(task.replicates[0])]
    attempts = []
    for i in range(len(task.replicates)):
        fresh: Task = pickle.loads(content)  # random streams as they were
        try:
            attempts += _outcomes(fresh.part(i), send)
        except Exception:
            attempts.append(_failure(task.replicates[i]))
    return attempts


def _outcomes(task: Task, send: Callable[[bytes], None]) -> list[dict[str, Any]]:
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
            answer = plain(estimate, times)
        if (length := len(pack(answer))) > LONGEST_ANSWER:
            raise ValueError(f"{length >> 20} MB, of which at most {LONGEST_ANSWER >> 20} are taken")
        return {"answer": answer}
    except Exception as error:
        message = f"the estimate cannot be scored: {one_line(error)}"
        return {"status": Status.INVALID.value, "message": message, "traceback": traceback_text()}


def _failure(replicate: int) -> dict[str, Any]:
    error = sys.exc_info()[1]
    assert error is not None
    if isinstance(error, MemoryError):
        status, message = Status.OOM, "out of memory"
    elif isinstance(error, OSError) and error.errno == errno.EFBIG:
        status, message = Status.CRASHED, f"it printed, or wrote to a file, more than {LONGEST_FILE >> 20} MB"
    else:
        status, message = Status.CRASHED, one_line(error)
    return {"replicate": replicate, "status": status.value, "message": message, "traceback": traceback_text()}


def _peak_memory_mb() -> float:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 2**20 if sys.platform == "darwin" else peak / 2**10


def _limit_memory(memory_mb: float | None) -> None:
    """Let one allocation beyond the limit fail at once, as an error that can be caught."""
    if memory_mb is None or not sys.platform.startswith("linux"):
        return
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    resource.setrlimit(resource.RLIMIT_DATA, (int(memory_mb * 2**20) + _data_bytes(), hard))


def _data_bytes() -> int:
    """Return the size of the data segment, which RLIMIT_DATA counts."""
    with open("/proc/self/status", "rb") as lines:  # as text, it would import a codec in every process
        return next((int(line.split()[1]) * 1024 for line in lines if line.startswith(b"VmData")), 0)


def _limit_processor_time(seconds: float) -> None:
    """Have the kernel end a fit that hangs where no other process can watch it any more."""
    usage = os.times()
    _, hard = resource.getrlimit(resource.RLIMIT_CPU)
    limit = int(usage.user + usage.system + seconds) + 1
    if hard == resource.RLIM_INFINITY or limit < hard:
        resource.setrlimit(resource.RLIMIT_CPU, (limit, hard))


class _Reporter:
    """Sends the best answer so far of each replicate: a fit that is ended is scored by its last one."""

    interval_s = 1.0

    def __init__(self, connection: Connection, task: Task) -> None:
        self.connection = connection
        self.places = {id(p): i for i, p in enumerate(task.payloads) if isinstance(p, Problem)}
        self.task, self.last = task, dict.fromkeys(self.places.values(), time.monotonic())

    def __call__(self, problem: Problem, estimate: Callable[[], Estimate]) -> None:
        i = self.places.get(id(problem))
        now = time.monotonic()
        if i is None or now - self.last[i] < self.interval_s:
            return
        self.last[i] = now
        outcome = {"replicate": self.task.replicates[i], **_answer(estimate(), self.task.times[i])}
        self.connection.send_bytes(REPORT + pack(outcome))
