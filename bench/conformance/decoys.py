"""Run a fit among decoys: a method that uses one of them changes its estimate, and access to files is recorded.

The decoys are wrong true values on the problem and in the frame of its caller, in a store, in a file and in a variable,
and a random stream with a wrong seed. In a sweep, methods have no access to any of these.
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import sys
import tempfile
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from bench.contract.estimate import Estimate
from bench.contract.method import Identifier
from bench.contract.problem import InitialState, Problem
from bench.scenario.stream import anonymous_stream
from bench.scenario.truth import Truth
from bench.store.store import DEFAULT_STORE, VARIABLE, default_archive

PARAMETERS = {"m": 1.7, "c": 0.9, "k": 19.0}
"""Wrong parameters, far from those of the data."""
ATTRIBUTES = ("truth", "_truth", "scenario", "parameters_true")
WRONG_SEED, WRONG_KEY = 7, (3, 1, 2, 0)
LOOKS = ("open", "os.listdir", "os.scandir")
"""Audit events (PEP 578) of access to files."""

_watched: list[tuple[tuple[str, ...], list[str]]] = []
"""Watched folders with the recorded accesses; empty except during a fit among decoys."""


def fit_among_decoys(method: Identifier, problem: Problem, seed: int) -> tuple[Estimate, list[str]]:
    """Return the estimate, and the method's accesses to stores and scenarios and attempts to connect."""
    parameters, looks = dict(PARAMETERS), list[str]()
    times, start = np.linspace(0.0, 8.0, 50), InitialState(np.array([0.5]), np.array([-0.2]))
    motion = np.cos(times)[None]
    truth = Truth(parameters, start, times, motion, times, motion, (0.01,), 30.0, 0.01)
    rng = anonymous_stream(seed)
    sequence: Any = rng.bit_generator.seed_seq
    sequence.entropy, sequence.spawn_key = WRONG_SEED, WRONG_KEY
    np.random.seed()  # noqa: NPY002 (the streams that all code of a process shares are in no known state)
    random.seed()
    text = json.dumps(PARAMETERS)
    _watch_files()
    with tempfile.TemporaryDirectory() as name:
        folder = os.path.realpath(name)
        store = Path(folder) / DEFAULT_STORE
        store.mkdir(parents=True)
        (store / f"{'0' * 20}.json").write_text(f'{{"cell": {{"data": {{"parameters": {text}}}}}}}')
        (Path(folder) / "truth.json").write_text(text)
        scenarios = (str(files("conf").joinpath(group)) for group in ("system", "development", "experiment"))
        variables = {"VIBRATION_BENCH_TRUTH": text, VARIABLE: str(store)}
        _watched.append(((folder, os.path.abspath(default_archive()), *scenarios), looks))
        for attribute in ATTRIBUTES:
            object.__setattr__(problem, attribute, truth)
        try:
            with mock.patch.dict(os.environ, variables), contextlib.chdir(folder):
                return method.identify(problem, rng), looks
        finally:
            _watched.clear()
            parameters.clear()  # references that a method has kept become empty
            for attribute in ATTRIBUTES:
                object.__delattr__(problem, attribute)


@cache
def _watch_files() -> None:
    """Install the audit hook once; it cannot be removed, and does nothing unless a folder is watched."""
    sys.addaudithook(_note)


def _note(event: str, arguments: tuple[Any, ...]) -> None:
    for folders, looks in _watched:
        if event == "socket.connect":
            looks.append("opened a connection")
        elif event in LOOKS and not isinstance(arguments[0], int):
            path = os.path.abspath(os.fsdecode(arguments[0] or "."))
            if path.startswith(folders):
                looks.append(f"looked into {'/'.join(Path(path).parts[-2:])}")
