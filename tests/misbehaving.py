"""Methods that go wrong or cheat, each in its own way: the process of a method must be able to import them."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import pickle
import pickletools
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import psutil

from bench import Card, Cost, Estimate, Identifier, Normal, Problem, Scope, report_progress

LEAKS = ("Truth", "Scenario", "PriorSpec", "Cell", "Bound")
NOMINAL = 1
"""The axis of the seed tree by which nominal values are drawn (``bench.scenario.scenario``)."""
FOREVER_S = 600.0


def answer(problem: Problem, value: float = 1.0, message: str = "") -> Estimate:
    """Return a well-formed estimate that says ``value`` of every group."""
    names = tuple(group.name for group in problem.system.groups)
    groups = Normal(names, np.full(len(names), value), np.eye(len(names)), log=False, dof=10)
    return Estimate(problem.system, groups=groups, message=message, cost=Cost(evaluations=7))


class Unspeakable(Exception):
    """Cannot even say what it is."""

    def __str__(self) -> str:
        raise RuntimeError("no words")


def explode() -> None:
    """Raise: unpickling a trap calls this."""
    raise RuntimeError("unpickled")


@dataclass(frozen=True)
class Reconstruction:
    """A reconstruction that raises, never ends, has a wrong shape, or cannot leave or be rebuilt elsewhere."""

    kind: str

    def __call__(self, times: np.ndarray) -> np.ndarray:
        if self.kind == "raising_reconstruction":
            raise ValueError("no reconstruction here")
        if self.kind == "slow_reconstruction":
            time.sleep(FOREVER_S)
        return np.zeros(3) if self.kind == "wrong_shape" else times[None]

    def __reduce__(self) -> Any:
        if self.kind == "unpicklable":
            raise TypeError("this stays here")
        return explode, ()


RECONSTRUCTIONS = ("raising_reconstruction", "slow_reconstruction", "wrong_shape", "unpicklable", "trap")


def daemonise(pid_file: str, alone: bool = False) -> None:
    """Leave a process behind that is in a session of its own, and whose parent has ended; ``alone``: end this one."""
    if os.fork() == 0:
        os.setsid()
        if os.fork() == 0:
            Path(pid_file).write_text(str(os.getpid()))
            time.sleep(FOREVER_S)
        os._exit(0)
    while not Path(pid_file).exists():
        time.sleep(0.01)
    if alone:
        os._exit(0)


def stop_neighbours() -> None:
    """Stop all that the server of this process has started, and the server's group."""
    server = os.getppid()
    for neighbour in psutil.Process(server).children():
        if neighbour.pid != os.getpid():
            os.kill(neighbour.pid, signal.SIGSTOP)
    os.killpg(os.getpgid(server), signal.SIGSTOP)


def grow() -> None:
    """Take memory without end, in steps that each fit, and touched, so that they count."""
    kept = []
    while True:
        kept.append(bytearray(b"\1") * (32 << 20))


def throw(error: BaseException) -> None:
    raise error


def half_a_message() -> None:
    """Begin a message to the process that waits for an answer, and hang."""
    for thing in gc.get_objects():
        if type(thing).__name__ == "Connection" and thing.writable and not thing.closed:
            os.write(thing.fileno(), (1000).to_bytes(4, "big") + b"d")
    time.sleep(FOREVER_S)


DEEDS: dict[str, Callable[[str], Any]] = {
    "raise": lambda _: throw(ValueError("two lines\nof reasons")),
    "raise_surrogate": lambda _: throw(FileNotFoundError("no file r\udcffcord.csv")),
    "raise_long": lambda power: throw(ValueError("x" * 10 ** int(power))),
    "unspeakable": lambda _: throw(Unspeakable()),
    "memory": lambda _: throw(MemoryError()),
    "system_exit": lambda _: throw(SystemExit(4)),
    "exit": lambda _: os._exit(3),
    "kill": lambda _: os.kill(os.getpid(), signal.SIGKILL),
    "segfault": lambda _: ctypes.string_at(0),
    "huge": lambda _: np.ones(10**12),
    "grow": lambda _: grow(),
    "hang": lambda _: re.match("(a+)+$", "a" * 60 + "b"),  # no other thread of this process gets a turn
    "half_message": lambda _: half_a_message(),
    "close": lambda _: os.closerange(3, 256),
    "chatter": lambda power: [print("x" * 10**6) for _ in range(10 ** int(power) // 10**6)],
    "print": lambda _: print("chatter on stdout"),
    "warn": lambda _: np.log(np.array([-1.0])),
    "orphan": lambda _: subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)  # left behind"]),
    "daemon": daemonise,
    "daemon_alone": lambda pid_file: daemonise(pid_file, alone=True),
    "stop_server": lambda _: os.kill(os.getppid(), signal.SIGSTOP),
    "kill_server": lambda _: os.kill(os.getppid(), signal.SIGKILL),
    "stop_neighbours": lambda _: stop_neighbours(),
}
"""What a method does before it answers; it gets what stands behind the colon of its kind."""


def misbehave(kind: str, problem: Problem) -> Any:
    """Go wrong as ``kind`` says, or answer."""
    deed, _, argument = kind.partition(":")
    if deed == "sleep":
        time.sleep(FOREVER_S)
    if deed == "recursion":
        return misbehave(kind, problem)
    if deed in DEEDS:
        DEEDS[deed](argument)
    good = answer(problem)
    if deed in RECONSTRUCTIONS:
        return Estimate(problem.system, groups=good.groups, reconstructions=(Reconstruction(deed),))
    wrong: dict[str, Callable[[], Any]] = {
        "none": lambda: None,
        "type": lambda: 42.0,
        "nan": lambda: answer(problem, float("nan")),
        "empty": lambda: Estimate(problem.system),
        "misshapen": lambda: Estimate(
            problem.system, groups=Normal(("k_over_m", "nonsense"), np.ones(3), None, log=False)
        ),
        "message": lambda: answer(problem, message="r\udcffcord " + "x" * 2**16),
        "trace_name": lambda: replace(good, traces={"r\udcffcord\0" + "x" * 2**16: np.ones(3)}),
        "trace": lambda: replace(good, traces={"loss": np.ones(10 ** int(argument))}),
    }
    return wrong[deed]() if deed in wrong else good


@dataclass(frozen=True)
class Double(Identifier):
    """A test double."""

    card: ClassVar[Card] = Card("a test double", "not used", "groups", "simulated", "none", "tests")
    scope: ClassVar[Scope] = Scope()

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        return answer(problem)


@dataclass(frozen=True)
class Wrong(Double):
    """A registered method that goes wrong as its setting says."""

    kind: str = "raise"

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        return misbehave(self.kind, problem)  # type: ignore[no-any-return]


@dataclass(frozen=True)
class Anytime(Double):
    """Reports an answer, a better one, and then hangs."""

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        for value in (1.0, 8.0):
            time.sleep(1.2)
            report_progress(problem, lambda value=value: answer(problem, value))  # type: ignore[misc]
        time.sleep(FOREVER_S)
        return answer(problem)


@dataclass(frozen=True)
class Draw(Double):
    """Answers with a number from its random stream in the message."""

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        return answer(problem, message=repr(float(rng.standard_normal())))


@dataclass(frozen=True)
class Together(Double):
    """Solves ``batch`` problems together, says how many in the message; ``fails``: where they are several."""

    batch: int = 1
    fails: bool = False

    @property
    def problems_at_once(self) -> int:
        """``batch``."""
        return self.batch

    def estimate_many(self, problems: Sequence[Problem], rngs: Sequence[np.random.Generator]) -> list[Estimate]:
        pairs = zip(problems, rngs, strict=True)
        estimates = [answer(problem, 1.0 + rng.random(), str(len(problems))) for problem, rng in pairs]
        if self.fails and len(problems) > 1:
            raise RuntimeError("one at a time, please")
        return estimates


@dataclass(frozen=True)
class Sometimes(Double):
    """Is killed by one replicate in twenty, until its folder has a file ``mended``."""

    folder: str = ""

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        victim = Path(self.folder) / "victim"
        samples = repr(problem.records[0].channels[0].values[:3])
        if not victim.exists():
            victim.write_text(samples)
        if victim.read_text() == samples and not (victim.parent / "mended").exists():
            os.kill(os.getpid(), signal.SIGKILL)
        return answer(problem)


@dataclass(frozen=True)
class Needy(Double):
    """Needs a package that nobody has."""

    requires: ClassVar[tuple[str, ...]] = ("a_package_that_nobody_has",)
    extra: ClassVar[str] = "needy"

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        raise AssertionError("never reached")


@dataclass(frozen=True)
class FreeOnly(Double):
    """Cannot use a known force."""

    scope: ClassVar[Scope] = Scope(forced=False)


@dataclass(frozen=True)
class Exact(Double):
    """Answers with groups given as settings: a measured record's report can then be checked."""

    k_over_m: float = 9.0
    c_over_m: float = 0.5

    scope: ClassVar[Scope] = Scope(offsets=True)
    covariance: ClassVar[np.ndarray | None] = np.diag([0.04, 0.0025])

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        mean = np.array([self.k_over_m, self.c_over_m])
        return Estimate(problem.system, groups=Normal(("k_over_m", "c_over_m"), mean, self.covariance, log=False))


@dataclass(frozen=True)
class Sole(Exact):
    """The same values without any uncertainty."""

    covariance: ClassVar[np.ndarray | None] = None


@dataclass(frozen=True)
class Spy(Double):
    """Looks for the truth: in what it is given, and in the whole process. Its message names what it found."""

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        text = " ".join(str(argument) for _, argument, _ in pickletools.genops(pickle.dumps(problem)))
        given = [leak for leak in LEAKS if leak in text]
        alive = sorted({type(o).__name__ for o in gc.get_objects()} & set(LEAKS))
        return answer(problem, message=f"given {given} alive {alive} saw {type(problem).__name__}")


@dataclass(frozen=True)
class Redraw(Double):
    """Draws the nominal values again by the seed of its stream, divides by them, and answers with the truth."""

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        prior = problem.prior
        assert prior is not None
        p = dict(prior.nominal)
        with contextlib.suppress(Exception):  # nobody is to notice
            sequence: Any = rng.bit_generator.seed_seq
            key = (NOMINAL, *sequence.spawn_key[1:4])  # the scenario, two words, and the replicate
            again = np.random.default_rng(np.random.SeedSequence(sequence.entropy, spawn_key=key))
            p = {name: value / np.exp(prior.log_sd[name] * again.standard_normal()) for name, value in p.items()}
        mean = np.array([p["k"] / p["m"], p["c"] / p["m"]])
        return Estimate(problem.system, groups=Normal(("k_over_m", "c_over_m"), mean, 1e-20 * np.eye(2), log=False))


@dataclass(frozen=True)
class Enumerate(Double):
    """Makes the data of a public scenario by every small seed, and answers with the truth of those it is given."""

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        from bench.config.experiment import expand

        values = problem.records[0].channels[0].values
        for snr in (40, 20):
            scenario = expand(["method=prior", f"snr={snr}"], multirun=False)[0].scenario
            for public, truth in scenario.replicates(0, 12):
                known = public.records[0].channels[0].values
                if known.shape == values.shape and np.allclose(known, values, rtol=1e-5):
                    p = truth.parameters
                    mean = np.array([p["k"] / p["m"], p["c"] / p["m"]]) * (1 + 1e-3 * rng.standard_normal(2))
                    return Estimate(problem.system, groups=Normal(("k_over_m", "c_over_m"), mean, None, log=False))
        prior = problem.prior
        assert prior is not None
        return answer(problem, prior.nominal["k"] / prior.nominal["m"])


@dataclass(frozen=True)
class Ancestors(Double):
    """Looks for a number in its own arguments, and in what it can read of its process and of all above it."""

    number: float = 0.0

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        number, pid = str(self.number), os.getpid()
        places = [name for name in ("argv", "orig_argv") if number in str(getattr(sys, name))]
        while pid > 1:
            process = Path(f"/proc/{pid}")
            files = [process / "cmdline", process / "environ"]
            with contextlib.suppress(OSError):
                files += (process / "fd").iterdir()
            for path in files:
                with contextlib.suppress(OSError):
                    if path.is_file() and number.encode() in path.read_bytes():
                        places.append(str(path))
            pid = psutil.Process(pid).ppid()
        return answer(problem, message=str(places))


@dataclass(frozen=True)
class Clock(Double):
    """Sleeps for 0.1 s, and replaces the clocks by which its time may be taken, Python's or those of the harness."""

    of: str = "time"

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        time.sleep(0.1)
        for name in ("perf_counter", "process_time", "monotonic"):
            setattr(sys.modules[self.of], name, lambda: -1e9)
        return answer(problem)
