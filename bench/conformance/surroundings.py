"""What lies around a fit and must not matter: a truth in reach, files, variables, and others' random numbers.

The truth in reach is a decoy: it is not that of the data. So whoever uses it, by whatever way, answers something else
than without it; and the usual ways are watched besides. In a sweep no truth is in a method's process at all: the checks
say who would take it if it were.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import random
import sys
import tempfile
from collections.abc import Callable, Iterator
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from bench.contract.estimate import Estimate
from bench.contract.problem import InitialState, Problem
from bench.scenario.truth import Truth
from bench.store.opening import DEFAULT_STORE, VARIABLE, default_archive

DECOYS = ({"m": 1.1, "c": 0.25, "k": 6.0}, {"m": 1.7, "c": 0.9, "k": 19.0})
"""Parameters that lie in reach; far from those of the data."""
NAMES = ("truth", "_truth", "scenario", "parameters_true")
"""Where on a problem they lie."""
DECOY_VARIABLE = "VIBRATION_BENCH_TRUTH"
GLANCES = {
    "sys._getframe": "looked at the frames of its callers",
    "sys._current_frames": "looked at the frames of all threads",
    "gc.get_objects": "looked through all objects of its process (gc)",
    "gc.get_referrers": "looked for what refers to an object (gc)",
    "gc.get_referents": "looked for what an object refers to (gc)",
    "socket.connect": "opened a connection to another machine",
}
"""Audit events (PEP 578), and what they say of the method's own code that causes them."""
LOOKUPS = ("open", "os.listdir", "os.scandir")
GO_BETWEENS = ("inspect", "traceback", "socket")
"""Modules of the standard library through which code looks at its callers on purpose."""
_watching: list[Surroundings] = []


class DecoyTruth(Truth):
    """A truth in reach, which writes down who reads it."""

    def __getattribute__(self, name: str) -> Any:
        if not name.startswith("__"):
            for one in _watching:
                one.note(f"read {name!r} of a truth that lay beside the problem")
        return super().__getattribute__(name)

    def __reduce_ex__(self, protocol: Any) -> tuple[Any, ...]:
        return decoy_truth, (dict(object.__getattribute__(self, "parameters")),)  # who copies a problem may


DecoyTruth.__name__ = DecoyTruth.__qualname__ = "Truth"  # as who looks for it by name knows it


def decoy_truth(parameters: dict[str, float]) -> Truth:
    """A truth with these parameters."""
    times = np.linspace(0.0, 8.0, 50)
    motion = np.exp(-parameters["c"] / (2 * parameters["m"]) * times)[None]
    start = InitialState(np.array([0.5]), np.array([-0.2]))
    return DecoyTruth(dict(parameters), start, times, motion, times, motion, (0.01,), 30.0, 0.01)


class Surroundings:
    """Decoys around a fit, and what a method did with them.

    Args:
        package: The name of the package, or module, whose doings count.
        which: Which of the decoys lies there.
    """

    def __init__(self, package: str, which: int) -> None:
        self.package, self.which = package, which
        self.seen: list[str] = []
        self.changes: list[str] = []
        self.folders: list[str] = []
        self._busy = False

    def note(self, what: str) -> None:
        """Write down what was seen, once."""
        if what not in self.seen:
            self.seen.append(what)

    def fit(self, fit: Callable[[Problem], Estimate], given: Problem) -> Estimate:
        """Fit with a decoy on the problem, in this frame, in files and in variables, and watch."""
        truth = decoy_truth(DECOYS[self.which])
        places = (given, given.records[0], given.records[0].channels[0], given.prior)
        for place, name in itertools.product(places, NAMES):
            object.__setattr__(place, name, truth)
        try:
            with self._watched():
                return fit(given)
        finally:
            for place, name in itertools.product(places, NAMES):
                object.__delattr__(place, name)

    @contextlib.contextmanager
    def _watched(self) -> Iterator[None]:
        parameters, archive = DECOYS[self.which], default_archive()
        with tempfile.TemporaryDirectory() as made, _global_streams(self.which):
            folder = Path(made).resolve()
            store = _files(folder, parameters)
            published = [archive] if Path(archive).is_absolute() else []
            self.folders = [str(folder), *published, *_configurations()]
            variables = {DECOY_VARIABLE: json.dumps(parameters), VARIABLE: str(store)}
            _install()
            with _variables(variables), contextlib.chdir(folder):
                _watching.append(self)
                try:
                    yield
                finally:
                    _watching.remove(self)

    def audit(self, event: str, arguments: tuple[Any, ...]) -> None:
        """Write down an audit event that tells of a look where nothing is a method's business."""
        if self._busy or (event not in GLANCES and event not in LOOKUPS):
            return
        self._busy = True
        try:
            if event in GLANCES:
                if self._own(sys._getframe(2)):
                    self.note(GLANCES[event])
            elif (place := _path(arguments)) and any(place.startswith(folder) for folder in self.folders):
                self.note(f"looked into {_said(place)}")
        finally:
            self._busy = False

    def _own(self, frame: Any) -> bool:
        """Whether the code that caused an event is the method's, directly or through a library made for it."""
        while frame is not None:
            root = str(frame.f_globals.get("__name__", "")).partition(".")[0]
            if root not in GO_BETWEENS:
                return root == self.package
            frame = frame.f_back
        return False


def _files(folder: Path, parameters: dict[str, float]) -> Path:
    """A store, and a file beside it, with the parameters, as somebody would look for them; returns the store's folder.

    What is in them is never read: to look is enough.
    """
    store = folder / DEFAULT_STORE
    store.mkdir(parents=True)
    description = json.dumps({"cell": {"data": {"parameters": parameters}}})
    (store / f"{'0' * 20}.json").write_text(description, encoding="utf-8")
    (folder / "truth.json").write_text(json.dumps(parameters), encoding="utf-8")
    return store


def _configurations() -> list[str]:
    """Folders of the scenarios' files, which hold true values."""
    conf = files("conf")
    return [str(conf.joinpath(name)) for name in ("system", "development", "experiment")]


def _path(arguments: tuple[Any, ...]) -> str:
    first = arguments[0] if arguments else None
    if isinstance(first, bytes):
        first = os.fsdecode(first)
    if first is None or isinstance(first, int):
        first = "." if first is None else ""
    return os.path.abspath(first) if first else ""


def _said(place: str) -> str:
    """The end of a path: which file it was, not where the machine keeps it."""
    return "/".join(Path(place).parts[-2:])


_installed = False


def _install() -> None:
    """Have audit events told; a hook cannot be taken away again, so there is one, idle while nothing is watched."""
    global _installed
    if not _installed:
        _installed = True
        sys.addaudithook(_hook)


def _hook(event: str, arguments: tuple[Any, ...]) -> None:
    for one in _watching:
        one.audit(event, arguments)


@contextlib.contextmanager
def _variables(given: dict[str, str]) -> Iterator[None]:
    before = {name: os.environ.get(name) for name in given}
    os.environ.update(given)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextlib.contextmanager
def _global_streams(seed: int) -> Iterator[None]:
    """Other states of the random streams that all code of a process shares."""
    numpys, pythons = np.random.get_state(), random.getstate()  # noqa: NPY002 (the state others may have left)
    np.random.seed(seed)  # noqa: NPY002
    random.seed(seed)
    try:
        yield
    finally:
        np.random.set_state(numpys)  # noqa: NPY002
        random.setstate(pythons)
