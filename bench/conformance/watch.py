"""Decoys around a fit, and a watch on what a method looks at: in a sweep no truth is there, nor may one be sought.

The decoys are a truth with wrong parameters beside the problem and in the frames of its callers, a store, a file and a
variable with them, and a random stream that notes who asks for its seed. Whoever uses a decoy answers otherwise than
without it; the usual ways to look for a truth are noted besides, by audit events (PEP 578).
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import sys
import tempfile
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from bench.contract.estimate import Estimate
from bench.contract.method import Identifier
from bench.contract.problem import InitialState, Problem
from bench.scenario.stream import AnonymousSeedSequence, anonymous_stream
from bench.scenario.truth import Truth
from bench.store.opening import DEFAULT_STORE, VARIABLE, default_archive

DECOY = {"m": 1.7, "c": 0.9, "k": 19.0}
"""Wrong parameters, far from those of the data."""
GLOBAL_SEED = 1
ATTRIBUTES = ("truth", "_truth", "scenario", "parameters_true")
DECOY_VARIABLE = "VIBRATION_BENCH_TRUTH"
SEED_ATTRIBUTES = ("entropy", "spawn_key")
GLANCES = {
    "sys._getframe": "looked at the frames of its callers",
    "sys._current_frames": "looked at the frames of all threads",
    "gc.get_objects": "looked through all objects of its process (gc)",
    "gc.get_referrers": "looked for what refers to an object (gc)",
    "gc.get_referents": "looked for what an object refers to (gc)",
    "socket.connect": "opened a connection to another machine",
}
"""Audit events, and what they say of the method's own code that causes them."""
LOOKUPS = ("open", "os.listdir", "os.scandir")
GO_BETWEENS = ("inspect", "traceback", "socket")
"""Modules of the standard library through which code looks at its callers on purpose."""
_active: list[Watch] = []
_hooked = False


class DecoyTruth(Truth):
    """A truth within reach that notes who reads it."""

    def __getattribute__(self, name: str) -> Any:
        if not name.startswith("__"):
            _note(f"read {name!r} of a truth that lay beside the problem")
        return super().__getattribute__(name)

    def __reduce_ex__(self, protocol: Any) -> tuple[Any, ...]:
        return decoy_truth, (dict(object.__getattribute__(self, "parameters")),)  # who copies a problem may


DecoyTruth.__name__ = DecoyTruth.__qualname__ = "Truth"  # as whoever looks for it by name knows it


def decoy_truth(parameters: dict[str, float]) -> Truth:
    """Return a truth with these parameters."""
    times = np.linspace(0.0, 8.0, 50)
    motion = np.exp(-parameters["c"] / (2 * parameters["m"]) * times)[None]
    start = InitialState(np.array([0.5]), np.array([-0.2]))
    return DecoyTruth(dict(parameters), start, times, motion, times, motion, (0.01,), 30.0, 0.01)


class DecoySeedSequence(AnonymousSeedSequence):
    """A seed sequence that notes who asks for its entropy or key, and has neither."""

    def __getattr__(self, name: str) -> Any:
        if name in SEED_ATTRIBUTES:
            _note(f"asked its random stream for its seed ({name})")
        raise AttributeError(name)


class Watch:
    """What the code of a ``package`` looked at during a fit among decoys."""

    def __init__(self, package: str) -> None:
        self.package = package
        self.seen: list[str] = []
        self._folders: list[str] = []

    def fit(self, method: Identifier, given: Problem, seed: int) -> Estimate:
        """Fit a problem, with other states of the global random streams besides."""
        truth = decoy_truth(DECOY)
        rng = anonymous_stream(seed)
        sequence: Any = rng.bit_generator.seed_seq
        sequence.__class__ = DecoySeedSequence
        for name in ATTRIBUTES:
            object.__setattr__(given, name, truth)
        try:
            with self._decoy_files(), _global_streams(GLOBAL_SEED), self._active_hook():
                return method.identify(given, rng)
        finally:
            for name in ATTRIBUTES:
                object.__delattr__(given, name)

    @contextlib.contextmanager
    def _decoy_files(self) -> Iterator[None]:
        """Work in a folder with a store and a file of parameters; looking is enough, what is in them is not read."""
        parameters = json.dumps(DECOY)
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name).resolve()
            store, conf = folder / DEFAULT_STORE, files("conf")
            store.mkdir(parents=True)
            (store / f"{'0' * 20}.json").write_text(f'{{"cell": {{"data": {{"parameters": {parameters}}}}}}}')
            (folder / "truth.json").write_text(parameters)
            scenarios = [str(conf.joinpath(group)) for group in ("system", "development", "experiment")]
            self._folders = [str(folder), *filter(os.path.isabs, [str(default_archive())]), *scenarios]
            variables = {DECOY_VARIABLE: parameters, VARIABLE: str(store)}
            with mock.patch.dict(os.environ, variables), contextlib.chdir(folder):
                yield

    @contextlib.contextmanager
    def _active_hook(self) -> Iterator[None]:
        """Have audit events handed to this watch; a hook cannot be removed, so there is one, idle without a watch."""
        global _hooked
        if not _hooked:
            _hooked = True
            sys.addaudithook(_hook)
        _active.append(self)
        try:
            yield
        finally:
            _active.remove(self)

    def audit(self, event: str, arguments: tuple[Any, ...]) -> None:
        """Note an audit event that shows a look where a method has no business."""
        if event in GLANCES and self._is_own(sys._getframe(2)):
            self.seen.append(GLANCES[event])
        elif event in LOOKUPS:
            place = "." if not arguments or arguments[0] is None else arguments[0]
            path = "" if isinstance(place, int) else os.path.abspath(os.fsdecode(place))
            if path.startswith(tuple(self._folders)):
                self.seen.append(f"looked into {'/'.join(Path(path).parts[-2:])}")

    def _is_own(self, frame: Any) -> bool:
        """Whether an event was caused by code of the package, directly or through a library made for it."""
        while frame is not None:
            root = str(frame.f_globals.get("__name__", "")).partition(".")[0]
            if root not in GO_BETWEENS:
                return root == self.package
            frame = frame.f_back
        return False


def _note(what: str) -> None:
    for watch in _active:
        watch.seen.append(what)


def _hook(event: str, arguments: tuple[Any, ...]) -> None:
    if _active and (event in GLANCES or event in LOOKUPS):
        watch = _active.pop()  # what the watch itself looks at is not noted
        try:
            watch.audit(event, arguments)
        finally:
            _active.append(watch)


@contextlib.contextmanager
def _global_streams(seed: int) -> Iterator[None]:
    """Set other states of the random streams that all code of a process shares."""
    numpys, pythons = np.random.get_state(), random.getstate()  # noqa: NPY002 (the state others may have left)
    np.random.seed(seed)  # noqa: NPY002
    random.seed(seed)
    try:
        yield
    finally:
        np.random.set_state(numpys)  # noqa: NPY002
        random.setstate(pythons)
