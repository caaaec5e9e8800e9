"""Child processes that may die, hang or grow: started from a server that has the heavy imports, ended by a kill.

Every child is the head of a process group of its own, writes whatever it prints to a file, and ends with the process
that started it, even when that one is killed.
"""

from __future__ import annotations

import contextlib
import faulthandler
import itertools
import multiprocessing
import os
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from multiprocessing import forkserver
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import psutil

from bench.isolation.mainless import without_main
from bench.isolation.temporary import check_temporary

THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")
NEEDED = (
    "bench.isolation.processes",
    "bench.sweep.method_process",
    "bench.sweep.scoring_process",
    "scipy.integrate",  # makes the truth of a nonlinear system
    "scipy.interpolate",  # which most methods use: each of their processes would import it anew
)
"""Modules that children import from their server."""
LOG_TAIL = 8000
"""How much of what a child printed is kept (characters)."""
READY_S = 300.0
"""How long a child may take to start."""


def single_threaded() -> None:
    """Fix numerical libraries loaded from now on to one thread: workers are processes, and share the cores."""
    for variable in THREAD_VARIABLES:
        os.environ[variable] = "1"


def compiled_single_threaded() -> None:
    """Fix what XLA compiles from now on to one thread, where the user has not said otherwise.

    A tracker's step is a hundred small operations, each of which is over sooner than another thread has taken it on.
    """
    os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")


class Died(Exception):
    """A child ended, hung or grew too large; ``reason`` is ``killed``, ``crashed``, ``timeout`` or ``oom``."""

    def __init__(self, reason: str, message: str, log: str) -> None:
        super().__init__(message)
        self.reason, self.message, self.log = reason, message, log


def start_server(preload: Sequence[str] = ()) -> None:
    """Start the server that all children are started from; it imports while its starter goes on.

    The first call decides what is preloaded; a later one changes nothing.
    """
    _context(preload)
    with without_main():
        forkserver.ensure_running()


def _context(preload: Sequence[str]) -> Any:
    check_temporary()
    single_threaded()
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([*NEEDED, *preload, "bench.isolation.frozen"])
    return context


class Children:
    """Starts children; one a run, since it owns their server, the folder of their logs, and their lifeline."""

    def __init__(self, preload: Sequence[str] = ()) -> None:
        self.context = _context(preload)
        self.folder = tempfile.TemporaryDirectory(prefix="vibration-bench-", ignore_cleanup_errors=True)
        self.lifeline, self._alive = self.context.Pipe(duplex=False)
        self.numbers = itertools.count()
        self._all: set[Child] = set()
        self._lock = threading.Lock()
        self.closed = False

    def start(self, serve: Callable[..., None], *arguments: Any) -> Child:
        """A child that runs ``serve(connection, *arguments)``."""
        with self._lock:
            if self.closed:
                raise Died("killed", "the run is over", "")
            with without_main():
                child = Child(self, serve, arguments)
            self._all.add(child)
        return child

    def forget(self, child: Child) -> None:
        with self._lock:
            self._all.discard(child)

    def close(self) -> None:
        """End every child."""
        with self._lock:
            self.closed, children = True, list(self._all)
        for child in children:
            child.kill()
        for connection in (self.lifeline, self._alive):
            connection.close()
        self.folder.cleanup()


class Child:
    """One child process and the connection to it. Messages are bytes; see :func:`serve_child` for the other side."""

    def __init__(self, children: Children, serve: Callable[..., None], arguments: Sequence[Any]) -> None:
        self._children = children
        self.log_path = Path(children.folder.name) / f"{next(children.numbers)}.log"
        self.connection, theirs = children.context.Pipe()
        self.process = children.context.Process(
            target=serve_child,
            args=(serve, theirs, children.lifeline, str(self.log_path), tuple(arguments)),
            daemon=True,
        )
        self.process.start()
        theirs.close()

    def send(self, message: bytes) -> None:
        """Send; a child that has died is seen at the next :meth:`receive`."""
        with contextlib.suppress(OSError):
            self.connection.send_bytes(message)

    def receive(self, limit_s: float, memory_mb: float | None = None) -> bytes:
        """The next message; raises Died, with the child ended, where none comes within the limits."""
        deadline = time.monotonic() + limit_s
        while True:
            left = deadline - time.monotonic()
            try:
                if self.connection.poll(max(0.0, min(left, 0.2))):
                    return self.connection.recv_bytes()  # type: ignore[no-any-return]
            except (EOFError, OSError):
                raise self._died() from None
            if left <= 0:
                self._ask_for_stack()
                raise self._ended("timeout", f"stopped after the limit of {limit_s:g} s")
            if memory_mb is not None and self.resident_mb() > memory_mb:
                raise self._ended("oom", f"stopped at the memory limit of {memory_mb:g} MB")

    def resident_mb(self) -> float:
        """Resident memory of the child and of all that it started."""
        total = 0.0
        with contextlib.suppress(psutil.Error):
            process = psutil.Process(self.process.pid)
            for one in (process, *_descendants(process)):
                with contextlib.suppress(psutil.Error):
                    total += one.memory_info().rss / 2**20
        return total

    def log(self) -> str:
        """The end of what the child printed, with the stack that it was ended in."""
        try:
            return self.log_path.read_text(encoding="utf-8", errors="replace")[-LOG_TAIL:]
        except OSError:
            return ""

    def _ask_for_stack(self) -> None:
        with contextlib.suppress(OSError, TypeError):
            os.kill(self.process.pid, signal.SIGUSR1)
            time.sleep(0.1)

    def _ended(self, reason: str, message: str) -> Died:
        self.kill()
        return Died(reason, message, self.log())

    def _died(self) -> Died:
        self.process.join(5)
        code = self.process.exitcode
        if code is not None and code < 0:
            name = signal.Signals(-code).name
            reason, message = "killed", f"its process was ended by {name}"
            if name == "SIGXCPU":
                reason, message = "timeout", "stopped after the limit of processor time"
        else:
            reason, message = "crashed", f"its process exited with status {code}"
        return self._ended(reason, message)

    def retire(self) -> None:
        """Let it end by itself: it sees that nobody waits for it any more."""
        self.connection.close()
        self.log_path.unlink(missing_ok=True)
        self._children.forget(self)

    def kill(self) -> None:
        """End it and all that it started, at once."""
        if self.process.pid is not None:
            with contextlib.suppress(OSError):
                os.killpg(self.process.pid, signal.SIGKILL)
        self.process.kill()
        self.process.join(10)
        with contextlib.suppress(OSError):
            self.connection.close()
        self._children.forget(self)


def serve_child(
    serve: Callable[..., None], connection: Connection, lifeline: Connection, log: str, arguments: tuple[Any, ...]
) -> None:
    """The whole life of a child."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with contextlib.suppress(OSError):
        os.setsid()
    file = os.open(log, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600)
    for stream in (1, 2):  # whatever a library prints must not mix with results and progress
        os.dup2(file, stream)
    faulthandler.enable(file=2)
    faulthandler.register(signal.SIGUSR1, file=2, all_threads=False)
    threading.Thread(target=_end_with_parent, args=(lifeline,), daemon=True).start()
    try:
        serve(connection, *arguments)
    except EOFError:
        pass  # nobody waits for it any more
    except BaseException:
        sys.excepthook(*sys.exc_info())
        sys.stderr.flush()
        os._exit(1)
    # what it started goes with it, and no library's clean-up can hang
    os.killpg(0, signal.SIGKILL)


def _descendants(process: psutil.Process) -> list[psutil.Process]:
    """All that a process started. To find any takes a look at every process there is, so that waits until there are."""
    with contextlib.suppress(OSError):  # where the kernel keeps no such lists
        if not any((task / "children").read_bytes() for task in Path(f"/proc/{process.pid}/task").iterdir()):
            return []
    return process.children(recursive=True)  # type: ignore[no-any-return]


def _end_with_parent(lifeline: Connection) -> None:
    with contextlib.suppress(EOFError, OSError):
        lifeline.poll(None)
    with contextlib.suppress(OSError):
        os.killpg(0, signal.SIGKILL)
    os._exit(1)
