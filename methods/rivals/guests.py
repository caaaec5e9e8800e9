"""A package of others at work in our process: nothing printed, and torch left as it was found."""

from __future__ import annotations

import io
import logging
import random
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout

import numpy as np

LOGGERS = ("lightning", "lightning.pytorch", "lightning.fabric", "lightning_utilities", "jax", "pytorch_lightning")
"""Of the packages and of what they bring; a handler of theirs writes to standard error."""


@contextmanager
def quiet() -> Iterator[None]:
    """Drop what is printed, warned and logged below the level of an error."""
    loggers = [logging.getLogger(name) for name in LOGGERS]
    levels = [logger.level for logger in loggers]
    shown = warnings.formatwarning
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for logger in loggers:
            logger.setLevel(logging.ERROR)
        try:
            yield
        finally:
            warnings.formatwarning = shown  # PINA sets one of its own
            for logger, level in zip(loggers, levels, strict=True):
                logger.setLevel(level)


@contextmanager
def torch_for_a_guest(threads: int, seed: int) -> Iterator[None]:
    """Torch on the processor, in double precision and seeded; then its settings and all random states as before."""
    import torch

    before = torch.get_num_threads(), torch.get_default_dtype(), torch.get_default_device()
    states = random.getstate(), np.random.get_state()  # noqa: NPY002 - that of the package is put back
    with torch.random.fork_rng(devices=[]):
        torch.set_num_threads(threads)
        torch.set_default_dtype(torch.float64)
        torch.set_default_device(None)
        torch.manual_seed(seed)
        try:
            yield
        finally:
            torch.set_num_threads(before[0])
            torch.set_default_dtype(before[1])
            torch.set_default_device(None if before[2] == torch.device("cpu") else before[2])
            random.setstate(states[0])
            np.random.set_state(states[1])  # noqa: NPY002
