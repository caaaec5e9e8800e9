"""A fit among decoys: whoever uses one answers otherwise than without it; looks into files are noted besides.

The decoys are a truth with wrong parameters on the problem and in the frame of its caller, a store, a file and a
variable with them, and a random stream with a wrong seed. In a sweep there is nothing of the kind to be found.
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
from typing import Any, ClassVar
from unittest import mock

import numpy as np

from bench.contract.estimate import Estimate
from bench.contract.method import Identifier
from bench.contract.problem import InitialState, Problem
from bench.scenario.stream import anonymous_stream
from bench.scenario.truth import Truth
from bench.store.opening import DEFAULT_STORE, VARIABLE, default_archive

DECOY = {"m": 1.7, "c": 0.9, "k": 19.0}
"""Wrong parameters, far from those of the data."""
ATTRIBUTES = ("truth", "_truth", "scenario", "parameters_true")
DECOY_VARIABLE = "VIBRATION_BENCH_TRUTH"
DECOY_SEED, DECOY_KEY = 7, (3, 1, 2, 0)
GLOBAL_SEED = 1
LOOKUPS = ("open", "os.listdir", "os.scandir")
"""Audit events (PEP 578) of a look at files."""


class Watch:
    """A fit among decoys, and in ``seen`` the files and connections that it tried."""

    _active: ClassVar[Watch | None] = None
    _hooked: ClassVar[bool] = False

    def __init__(self) -> None:
        self.seen: list[str] = []
        self._folders: tuple[str, ...] = ()

    def fit(self, method: Identifier, given: Problem, seed: int) -> Estimate:
        """Fit a problem, with other states of the global random streams besides."""
        times = np.linspace(0.0, 8.0, 50)
        motion = np.cos(times)[None]
        start = InitialState(np.array([0.5]), np.array([-0.2]))
        parameters = dict(DECOY)
        truth = Truth(parameters, start, times, motion, times, motion, (0.01,), 30.0, 0.01)
        rng = anonymous_stream(seed)
        sequence: Any = rng.bit_generator.seed_seq
        sequence.entropy, sequence.spawn_key = DECOY_SEED, DECOY_KEY
        for name in ATTRIBUTES:
            object.__setattr__(given, name, truth)
        if not Watch._hooked:  # a hook cannot be removed, so there is one, idle without a watch
            sys.addaudithook(Watch._hook)
            Watch._hooked = True
        try:
            with _decoy_files() as folder, _global_streams(GLOBAL_SEED):
                scenarios = (files("conf").joinpath(group) for group in ("system", "development", "experiment"))
                self._folders = (str(folder), os.path.abspath(default_archive()), *map(str, scenarios))
                Watch._active = self
                try:
                    return method.identify(given, rng)
                finally:
                    Watch._active = None
        finally:
            parameters.clear()  # whoever still finds the truth finds nothing in it
            for name in ATTRIBUTES:
                object.__delattr__(given, name)

    @staticmethod
    def _hook(event: str, arguments: tuple[Any, ...]) -> None:
        if Watch._active is not None:
            Watch._active._audit(event, arguments)

    def _audit(self, event: str, arguments: tuple[Any, ...]) -> None:
        if event == "socket.connect":
            self.seen.append("opened a connection")
        elif event in LOOKUPS:
            place = "." if not arguments or arguments[0] is None else arguments[0]
            path = "" if isinstance(place, int) else os.path.abspath(os.fsdecode(place))
            if path.startswith(self._folders):
                self.seen.append(f"looked into {'/'.join(Path(path).parts[-2:])}")


@contextlib.contextmanager
def _decoy_files() -> Iterator[Path]:
    """Work in a folder with a store and a file of parameters, and with variables that name them."""
    parameters = json.dumps(DECOY)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name).resolve()
        store = folder / DEFAULT_STORE
        store.mkdir(parents=True)
        (store / f"{'0' * 20}.json").write_text(f'{{"cell": {{"data": {{"parameters": {parameters}}}}}}}')
        (folder / "truth.json").write_text(parameters)
        variables = {DECOY_VARIABLE: parameters, VARIABLE: str(store)}
        with mock.patch.dict(os.environ, variables), contextlib.chdir(folder):
            yield folder


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
