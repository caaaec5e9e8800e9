"""Child processes with limits, forked from a server that has imported the large packages.

Every child leads its own process group, prints to a log file, and ends together with its descendants when the process
that started it ends, even if that one is killed. A thread watches the children: it ends those that exceed their limits,
even in the middle of a message, and continues those that another child has stopped.
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
from collections.abc import Callable, Iterator, Sequence
from multiprocessing import forkserver, resource_tracker
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, ClassVar

import psutil

from bench.errors import InputError
from bench.isolation.descendants import adopt, descendants_of, end_descendants, end_orphans, end_own_descendants
from bench.isolation.machine import raise_file_limit, single_threaded
from bench.isolation.secrecy import without_main

NEEDED = (
    "bench.engine.runner",
    "scipy.integrate",  # simulates nonlinear systems
    "scipy.interpolate",  # used by most methods
)
"""Modules that the server imports, so that its children need not."""
LONGEST_TMPDIR = 75
"""Longest path of the folder for temporary files: Linux limits the path of a socket to 107 bytes, and Python appends
32."""
LOG_TAIL = 8000
"""Length of the end of a child's output that is kept (bytes)."""
LONGEST_MESSAGE = 512 << 20
"""Longest message that is read (bytes), to protect the memory of the driver."""
READY_S = 300.0
"""Time limit for the start of a child (s)."""
STARTS, PAUSE_S = 6, 0.2
"""Number of attempts to start a child, and the pause between them (s), in which a killed server ends."""
WATCH_S = 0.2
"""Interval between checks of the children (s)."""


class Died(Exception):
    """A child ended or exceeded a limit; ``reason`` is ``killed``, ``crashed``, ``timeout`` or ``oom``."""

    def __init__(self, reason: str, message: str, log: str) -> None:
        super().__init__(message)
        self.reason, self.message, self.log = reason, message, log


def start_server(preload: Sequence[str] = ()) -> None:
    """Start the server from which all children are forked; it imports its packages in the background.

    A running server that lacks some of the packages is restarted, unless it has children.
    """
    _context(preload)
    with without_main(), _without_interrupts():
        forkserver.ensure_running()


def _context(preload: Sequence[str]) -> Any:
    if len(os.fsencode(folder := tempfile.gettempdir())) > LONGEST_TMPDIR:
        raise InputError("TMPDIR", folder, f"use a path of at most {LONGEST_TMPDIR} bytes, the limit for sockets in it")
    single_threaded()
    raise_file_limit()
    context = multiprocessing.get_context("forkserver")
    server, missing = _server(), set(preload) - Children.preloaded
    if server is not None and missing and not Children.known:
        os.kill(server, signal.SIGKILL)
        os.waitid(os.P_PID, server, os.WEXITED | os.WNOWAIT)  # multiprocessing notices the end and starts another
    if server is None or missing:
        Children.preloaded = frozenset(preload)
        context.set_forkserver_preload([*NEEDED, *preload, "bench.isolation.server_setup"])
    return context


def _server() -> int | None:
    """Return the process ID of the server; None if it is not running."""
    pid = getattr(forkserver._forkserver, "_forkserver_pid", None)  # there is no public name
    with contextlib.suppress(psutil.Error):  # the parent is checked, since the number may have been reused
        return pid if pid is not None and psutil.Process(pid).ppid() == os.getpid() else None
    return None


def _signal(pid: int | None, number: signal.Signals) -> None:
    if pid is not None:
        with contextlib.suppress(OSError):
            os.kill(pid, number)


class Children:
    """The child processes of a run, with the folder of their logs and the pipe whose closing ends them.

    The server and the list of its children are shared by all instances in this process.
    """

    starting = threading.Lock()
    """Lock for the start of a child, the reading of an exit status, and the search for unknown children."""
    known: ClassVar[set[int]] = set()
    """Process IDs of the running children of the server."""
    preloaded: ClassVar[frozenset[str]] = frozenset()
    """The packages that the server imports."""

    def __init__(self, preload: Sequence[str] = ()) -> None:
        self.context = _context(preload)
        self.folder = tempfile.TemporaryDirectory(prefix="vibration-bench-", ignore_cleanup_errors=True)
        self.lifeline, self._alive = self.context.Pipe(duplex=False)
        self.numbers = itertools.count()
        self._all: set[Child] = set()
        self._lock = threading.Lock()
        self._closed = threading.Event()
        threading.Thread(target=self._watch, daemon=True).start()

    def __enter__(self) -> Children:
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()

    def start(self, serve: Callable[..., None], *arguments: Any) -> Child:
        """Start a child that runs ``serve(connection, *arguments)``; raises InputError if that is impossible."""
        reason: Exception | None = None
        for attempt in range(STARTS):
            self._closed.wait(PAUSE_S * min(attempt, 1))
            with self.starting:
                if self._closed.is_set():
                    raise Died("killed", "the run is over", "")
                try:
                    with without_main():
                        child = Child(self, serve, arguments)
                except (OSError, EOFError) as error:  # the server has ended, or no file descriptor is left
                    reason = error
                    continue
                self.known.add(child.pid)
            with self._lock:
                self._all.add(child)
            if self._closed.is_set():  # close() may have missed this child
                child.kill()
            return child
        why = getattr(reason, "strerror", None) or type(reason).__name__
        raise InputError("workers", len(self._all), f"no further process can be started ({why}); use fewer workers")

    def forget(self, child: Child) -> None:
        """Remove a child that has ended or is about to end."""
        with self._lock:
            self._all.discard(child)
        self.known.discard(child.pid)

    def end_orphans(self) -> None:
        """End the orphans that the server has adopted."""
        _signal(_server(), signal.SIGCONT)  # a stopped server would block a start that holds the lock
        with self.starting:
            if server := _server():
                end_orphans(server, self.known)

    def close(self) -> None:
        """End every child."""
        self._closed.set()
        _signal(_server(), signal.SIGCONT)  # a stopped server does not report the end of its children
        for child in self._now():
            child.kill()
        self.end_orphans()
        for connection in (self.lifeline, self._alive):
            connection.close()
        self.folder.cleanup()

    def _now(self) -> list[Child]:
        with self._lock:
            return list(self._all)

    def _watch(self) -> None:
        while not self._closed.wait(WATCH_S):
            _signal(_server(), signal.SIGCONT)
            for child in self._now():
                child.watch()


class Child:
    """A child process and the connection to it; messages are bytes. The child runs :func:`serve_child`."""

    def __init__(self, children: Children, serve: Callable[..., None], arguments: Sequence[Any]) -> None:
        self._children = children
        self.log_path = Path(children.folder.name) / f"{next(children.numbers)}.log"
        self.connection, child_end = children.context.Pipe()
        child_arguments = (serve, child_end, children.lifeline, str(self.log_path), tuple(arguments))
        try:
            self.process = children.context.Process(target=serve_child, args=child_arguments, daemon=True)
            with _without_interrupts():
                self.process.start()
        except BaseException:
            self.connection.close()
            raise
        finally:
            child_end.close()
        self.pid: int = self.process.pid
        self._watched: list[Any] = [self.connection, self.process.sentinel]
        self._lock = threading.Lock()
        self._limits: tuple[float, float, float | None] | None = None
        """While a message is awaited: deadline, time limit (s) and memory limit (MB)."""
        self._verdict: tuple[str, str] | None = None
        """Reason and message of its end, once a limit is exceeded."""

    def send(self, message: bytes) -> None:
        """Send a message and clear the log; if the child has died, the next :meth:`receive` raises Died."""
        with contextlib.suppress(OSError):
            os.truncate(self.log_path, 0)
        with contextlib.suppress(OSError):
            self.connection.send_bytes(message)

    def receive(self, limit_s: float, memory_mb: float | None = None) -> bytes:
        """Return the next message; if none arrives within the limits, end the child and raise Died."""
        deadline = time.monotonic() + limit_s
        with self._lock:
            self._limits = (deadline, limit_s, memory_mb)
        try:
            message = self._next_message()
        except OSError:
            message = None
            if self.connection.closed and self._verdict is None:
                self._verdict = "crashed", f"the answer is longer than {LONGEST_MESSAGE >> 20} MB"
        with self._lock:
            self._limits = None
            if message is not None and time.monotonic() > deadline:
                self._verdict = self._verdict or ("timeout", _late(limit_s))
        if message is None or self._verdict:
            raise self._died()
        return message

    def _next_message(self) -> bytes | None:
        while True:
            ready = wait(self._watched)
            try:
                if self.connection in ready:
                    return self.connection.recv_bytes(LONGEST_MESSAGE)  # type: ignore[no-any-return]
            except EOFError:
                return None
            if not self._alive():  # a descendant keeps the connection open
                return None
            self._watched = [self.connection]  # the sentinel reports the end of the server, not of the child

    def watch(self) -> None:
        """Continue the child if another has stopped it, and end it if it exceeds a limit."""
        _signal(self.pid, signal.SIGCONT)
        with self._lock:
            if self._limits is None or self._verdict:
                return
            deadline, limit_s, memory_mb = self._limits
            if time.monotonic() > deadline:
                self._verdict = "timeout", _late(limit_s)
            elif memory_mb is not None and self.resident_mb() > memory_mb:
                self._verdict = "oom", f"stopped at the memory limit of {memory_mb:g} MB"
            else:
                return
        if self._verdict[0] == "timeout":
            _signal(self.pid, signal.SIGUSR1)  # the child writes its stack to the log
            time.sleep(0.1)
        self._end_all()

    def resident_mb(self) -> float:
        """Return the resident memory of the child and its descendants (MB)."""
        total = 0.0
        for pid in (self.pid, *descendants_of(self.pid)):
            with contextlib.suppress(psutil.Error):
                total += psutil.Process(pid).memory_info().rss / 2**20
        return total

    def _alive(self) -> bool:
        with contextlib.suppress(psutil.Error):
            return psutil.Process(self.pid).status() not in (psutil.STATUS_ZOMBIE, psutil.STATUS_DEAD)
        return False

    def _died(self) -> Died:
        if self._verdict is None:
            with self._children.starting:  # a start also reads exit statuses, each of which can be read only once
                self.process.join(5)
            code = self.process.exitcode
            if code is None or code >= 0:
                self._verdict = "crashed", f"the process exited with status {code}"
            elif -code == signal.SIGXCPU:
                self._verdict = "timeout", "stopped at the limit of processor time"
            else:
                self._verdict = "killed", f"the process was ended by {signal.Signals(-code).name}"
        self.kill()
        log = ""
        with contextlib.suppress(OSError), self.log_path.open("rb") as file:
            file.seek(max(0, file.seek(0, os.SEEK_END) - LOG_TAIL))
            log = file.read().decode("utf-8", errors="replace")
        self.log_path.unlink(missing_ok=True)
        return Died(*self._verdict, log)

    def retire(self) -> None:
        """Close the connection, after which the child ends by itself."""
        self._hang_up()
        self.log_path.unlink(missing_ok=True)
        self._children.forget(self)

    def kill(self) -> None:
        """End the child and its descendants immediately."""
        self._end_all()
        self.process.join(10)
        self._hang_up()
        self._children.forget(self)
        self._children.end_orphans()

    def _end_all(self) -> None:
        end_descendants(self.pid)  # first, since descendants are found only while the child lives
        with contextlib.suppress(OSError):
            os.killpg(self.pid, signal.SIGKILL)
        self.process.kill()

    def _hang_up(self) -> None:
        """Close the connection under the lock, since its descriptor could be reused between two calls."""
        with self._lock, contextlib.suppress(OSError):
            self.connection.close()


def _late(limit_s: float) -> str:
    return f"stopped after the limit of {limit_s:g} s"


@contextlib.contextmanager
def _without_interrupts() -> Iterator[None]:
    """Start processes that Ctrl-C does not reach, even while they import; it reaches this process afterwards."""
    resource_tracker.ensure_running()  # its own start would end the blocking
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def serve_child(
    serve: Callable[..., None], connection: Connection, lifeline: Connection, log: str, arguments: tuple[Any, ...]
) -> None:
    """Live the whole life of a child."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with contextlib.suppress(OSError):
        os.setsid()
    adopt()
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
    _end_group()


def _end_group() -> None:
    """End this process with all that it started; no library's clean-up can hang."""
    end_own_descendants()
    os.killpg(0, signal.SIGKILL)


def _end_with_parent(lifeline: Connection) -> None:
    with contextlib.suppress(EOFError, OSError):
        lifeline.poll(None)
    with contextlib.suppress(OSError):
        _end_group()
    os._exit(1)
