"""Methods that go wrong, each in its own way, and one that spies: a worker process must be able to import them."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import pathlib
import pickle
import pickletools
import re
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import psutil

from bench import Card, Cost, Estimate, Identifier, Normal, Problem, Serves, report_progress

NOMINAL = 1
"""The axis of the seed tree by which nominal values are drawn (``bench.scenario.scenario``)."""
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


class Unspeakable(Exception):
    """Cannot even say what it is."""

    def __str__(self) -> str:
        raise RuntimeError("no words")


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


@dataclass(frozen=True)
class Endless:
    """A reconstruction that never comes back."""

    def __call__(self, times: np.ndarray) -> np.ndarray:
        time.sleep(600)
        return times[None]


@dataclass(frozen=True)
class Scalar:
    """A reconstruction of the wrong shape."""

    def __call__(self, times: np.ndarray) -> np.ndarray:
        return np.zeros(3)


def daemonise(pid_file: str) -> None:
    """Leave a process behind that is in a session of its own, and whose parent has ended."""
    if os.fork() == 0:
        os.setsid()
        if os.fork() == 0:
            pathlib.Path(pid_file).write_text(str(os.getpid()))
            time.sleep(600)
        os._exit(0)
    while not pathlib.Path(pid_file).exists():
        time.sleep(0.01)


def stop_neighbours() -> None:
    """Stop all that the server of this process has started, and the server's group."""
    server = os.getppid()
    for neighbour in psutil.Process(server).children():
        if neighbour.pid != os.getpid():
            os.kill(neighbour.pid, signal.SIGSTOP)
    os.killpg(os.getpgid(server), signal.SIGSTOP)


def misbehave(kind: str, problem: Problem) -> Any:
    """Go wrong as ``kind`` says, or answer."""
    good = answer(problem)
    kind, _, argument = kind.partition(":")
    if kind == "raise_surrogate":
        raise FileNotFoundError("no file r\udcffcord.csv")
    if kind == "raise_long":
        raise ValueError("x" * 10 ** int(argument))
    if kind == "message":
        return answer(problem, message="r\udcffcord " + "x" * 2**16)
    if kind == "trace_name":
        return replace(good, traces={"r\udcffcord\0" + "x" * 2**16: np.ones(3)})
    if kind == "trace":
        return replace(good, traces={"loss": np.ones(10 ** int(argument))})
    if kind == "unspeakable":
        raise Unspeakable
    if kind == "chatter":
        for _ in range(10 ** int(argument) // 10**6):
            print("x" * 10**6)
    if kind == "daemon":
        daemonise(argument)
    if kind == "daemon_alone":
        daemonise(argument)
        os._exit(0)
    if kind == "stop_server":
        os.kill(os.getppid(), signal.SIGSTOP)
    if kind == "stop_neighbours":
        stop_neighbours()
    if kind == "kill_server":
        os.kill(os.getppid(), signal.SIGKILL)
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
    if kind == "system_exit":
        raise SystemExit(4)
    if kind == "segfault":
        ctypes.string_at(0)
    if kind == "huge":
        np.ones(10**12)
    if kind == "grow":
        kept = []
        while True:  # in steps that each fit, and touched, so that they count
            kept.append(bytearray(b"\1") * (32 << 20))
    if kind == "hang":
        re.match("(a+)+$", "a" * 60 + "b")  # no other thread of this process gets a turn
    if kind == "recursion":
        return misbehave(kind, problem)
    if kind == "close":
        os.closerange(3, 256)
    if kind == "none":
        return None
    if kind == "orphan":
        subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)  # left behind"])
    if kind == "slow_reconstruction":
        return Estimate(problem.system, groups=good.groups, reconstructions=(Endless(),))
    if kind == "wrong_shape":
        return Estimate(problem.system, groups=good.groups, reconstructions=(Scalar(),))
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
class Wrong(Identifier):
    """A registered method that goes wrong as its setting says."""

    kind: str = "raise"

    card: ClassVar[Card] = CARD
    serves: ClassVar[Serves] = Serves()

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        return misbehave(self.kind, problem)  # type: ignore[no-any-return]


@dataclass(frozen=True)
class Anytime(Identifier):
    """Reports an answer, a better one, and then hangs."""

    card: ClassVar[Card] = CARD
    serves: ClassVar[Serves] = Serves()

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        for value in (1.0, 8.0):
            time.sleep(1.2)
            report_progress(problem, lambda value=value: answer(problem, value))  # type: ignore[misc]
        time.sleep(600)
        return answer(problem)


@dataclass(frozen=True)
class Draw(Identifier):
    """Answers with a number from its random stream in the message."""

    card: ClassVar[Card] = CARD
    serves: ClassVar[Serves] = Serves()

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        return answer(problem, message=repr(float(rng.standard_normal())))


@dataclass(frozen=True)
class Together(Identifier):
    """Solves ``batch`` problems together, says how many it got in the message, and dies of company where told to."""

    batch: int = 1
    alone: bool = False

    card: ClassVar[Card] = CARD
    serves: ClassVar[Serves] = Serves()

    @property
    def problems_at_once(self) -> int:
        """``batch``."""
        return self.batch

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        raise AssertionError("never reached")

    def estimate_many(self, problems: Sequence[Problem], rngs: Sequence[np.random.Generator]) -> list[Estimate]:
        if self.alone and len(problems) > 1:
            os.kill(os.getpid(), signal.SIGKILL)
        pairs = zip(problems, rngs, strict=True)
        return [answer(problem, 1.0 + rng.random(), str(len(problems))) for problem, rng in pairs]


@dataclass(frozen=True)
class Spy(Identifier):
    """Looks for the truth: in what it is given, and in the whole process. Its message names what it found."""

    card: ClassVar[Card] = CARD
    serves: ClassVar[Serves] = Serves()

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        text = " ".join(str(argument) for _, argument, _ in pickletools.genops(pickle.dumps(problem)))
        given = [leak for leak in LEAKS if leak in text]
        alive = sorted({type(o).__name__ for o in gc.get_objects()} & set(LEAKS))
        return answer(problem, message=f"given {given} alive {alive} saw {type(problem).__name__}")


@dataclass(frozen=True)
class Redraw(Identifier):
    """Draws the nominal values again by the seed of its stream, divides by them, and answers with the truth."""

    card: ClassVar[Card] = CARD
    serves: ClassVar[Serves] = Serves()

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        prior = problem.prior
        assert prior is not None
        p = dict(prior.nominal)
        with contextlib.suppress(Exception):  # nobody is to notice
            seeded: Any = rng.bit_generator.seed_seq
            _, first, second, replicate, *_ = seeded.spawn_key
            key = (NOMINAL, first, second, replicate)
            again = np.random.default_rng(np.random.SeedSequence(seeded.entropy, spawn_key=key))
            p = {name: value / np.exp(prior.log_sd[name] * again.standard_normal()) for name, value in p.items()}
        mean = np.array([p["k"] / p["m"], p["c"] / p["m"]])
        return Estimate(problem.system, groups=Normal(("k_over_m", "c_over_m"), mean, 1e-20 * np.eye(2), log=False))


@dataclass(frozen=True)
class Ancestors(Identifier):
    """Looks for a number in its own arguments, and in what it can read of its process and of all above it."""

    number: float = 0.0

    card: ClassVar[Card] = CARD
    serves: ClassVar[Serves] = Serves()

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        number = str(self.number)
        found = [name for name in ("argv", "orig_argv") if number in str(getattr(sys, name))]
        pid = os.getpid()
        while pid > 1:
            process = pathlib.Path(f"/proc/{pid}")
            for path in (process / "cmdline", process / "environ", *self.files(process)):
                with contextlib.suppress(OSError):
                    if path.is_file() and number.encode() in path.read_bytes():
                        found.append(str(path))
            pid = int((process / "stat").read_text().rpartition(")")[2].split()[1])
        return answer(problem, message=str(found))

    @staticmethod
    def files(process: pathlib.Path) -> list[pathlib.Path]:
        """Files that a process holds open."""
        with contextlib.suppress(OSError):
            return list((process / "fd").iterdir())
        return []


@dataclass(frozen=True)
class Clock(Identifier):
    """Sleeps for 0.1 s, and replaces the clocks that its time may be taken by, of Python or of the harness."""

    of: str = "time"

    card: ClassVar[Card] = CARD
    serves: ClassVar[Serves] = Serves()

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        time.sleep(0.1)
        for name in ("perf_counter", "process_time", "monotonic"):
            setattr(sys.modules[self.of], name, lambda: -1e9)
        return answer(problem)


@dataclass(frozen=True)
class Sometimes(Identifier):
    """Is killed by one replicate in twenty, until a file says that it is mended."""

    folder: str = ""

    card: ClassVar[Card] = CARD
    serves: ClassVar[Serves] = Serves()

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        folder = pathlib.Path(self.folder)
        marked = folder / "victim"
        mine = repr(problem.records[0].channels[0].values[:3])
        if not marked.exists():
            marked.write_text(mine)
        if marked.read_text() == mine and not (folder / "mended").exists():
            os.kill(os.getpid(), signal.SIGKILL)
        return answer(problem)


@dataclass(frozen=True)
class Marks(Identifier):
    """Leaves a file each time it is run."""

    folder: str = ""

    card: ClassVar[Card] = CARD
    serves: ClassVar[Serves] = Serves()

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        (pathlib.Path(self.folder) / f"mark-{os.getpid()}-{time.time_ns()}").touch()
        time.sleep(0.1)
        return answer(problem)


@dataclass(frozen=True)
class Needy(Identifier):
    """Needs a package that nobody has."""

    card: ClassVar[Card] = CARD
    requires: ClassVar[tuple[str, ...]] = ("a_package_that_nobody_has",)
    extra: ClassVar[str] = "needy"

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        raise AssertionError("never reached")


@dataclass(frozen=True)
class FreeOnly(Identifier):
    """Cannot use a known force."""

    card: ClassVar[Card] = CARD
    serves: ClassVar[Serves] = Serves(forced=False)

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        return answer(problem)


@dataclass(frozen=True)
class Exact(Identifier):
    """Answers with groups given as settings: a measured record's report can then be checked."""

    k_over_m: float = 9.0
    c_over_m: float = 0.5

    card: ClassVar[Card] = CARD
    serves: ClassVar[Serves] = Serves(offsets=True)

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        covariance = np.diag([0.04, 0.0025])
        mean = np.array([self.k_over_m, self.c_over_m])
        return Estimate(problem.system, groups=Normal(("k_over_m", "c_over_m"), mean, covariance, log=False))


@dataclass(frozen=True)
class Sole(Exact):
    """The same values without any uncertainty."""

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        found = super().estimate(problem, rng)
        assert found.groups is not None
        return replace(found, groups=replace(found.groups, covariance=None))


class NotAMethod:
    """What a broken entry point may name."""
