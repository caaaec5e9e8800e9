"""What the three methods share: settings, the problem as every package gets it, the path and the end of a fit.

The problem is one free decay in natural units, on a time from -1 to 1. With ``s = 2 t / duration - 1`` and omega the
frequency of our start scan's wave, the equation of motion over omega² is

    ``(rate / omega)² u'' + (c/m / omega) (rate / omega) u' + (k/m / omega²) u = 0``,  ``rate = 2 / duration``,

so that its mean square is of order one, like that of the data, and stands in the loss with weight 1; so does a known
initial state, as ``u(-1) = x0`` and ``rate u'(-1) / omega = v0 / omega``. The scan is that of :mod:`methods.pinn`.
"""

from __future__ import annotations

import io
import logging
import random
import time
import warnings
from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from bench import Card, Cost, Estimate, Identifier, InputError, NoEstimate, Normal, Problem, Scope, report_progress
from methods.network.response import NetworkResponse
from methods.pinn.task import starts
from methods.starts.rounding import rounded
from methods.starts.waves import scan

COLLOCATION = 200
"""Points at which the equation of motion is asked for, evenly spaced over the record, its ends included."""
HIDDEN = (64, 64)
"""Units of the hidden layers."""
ADAM_RATE = 1e-3
ADAM_SHARE = 0.3
"""Of the processor time of the training; the second optimiser has the rest."""
SPACING = 1.035
"""Processor time at one moment of the path over that at the one before, at least."""
LOGGERS = ("lightning", "lightning.pytorch", "lightning.fabric", "lightning_utilities", "jax", "pytorch_lightning")
"""Of the packages and of what they bring; a handler of theirs writes to standard error."""

Layers = Sequence[tuple[np.ndarray, np.ndarray]]
"""Weights (n_out, n_in) and biases (n_out,), layer by layer."""
Now = tuple[float, float, float]
"""log(k/m), log(c/m) and the loss."""


class DecayRecord:
    """The record of a problem, to ten digits, and where to start, from the best wave of the start scan.

    ``times`` (n,) from -1 to 1, ``values`` (n,); ``known_start`` is (x0, v0 / omega) or None. ``logs`` are log(k/m) and
    log(c/m) to start from, ``units`` what these are less by in units of omega; ``speed`` is rate over omega.
    """

    def __init__(self, problem: Problem) -> None:
        scaled = rounded(problem)
        guess = starts(scaled, *scan(scaled, forced=True, beyond=True))[0][0]
        record = scaled.records[0]
        channel, start = record.channels[0], record.initial_state
        self.times, self.values = 2.0 * channel.times / record.duration - 1.0, channel.values
        self.known_start: tuple[float, float] | None = None
        if start is not None:
            self.known_start = float(start.displacement[0]), float(start.velocity[0]) / guess.omega
        self.logs = float(np.log(guess.omega**2 + guess.decay**2)), float(np.log(2.0 * guess.decay))
        self.units = float(2.0 * np.log(guess.omega)), float(np.log(guess.omega))
        self.duration, self.speed = record.duration, 2.0 / (record.duration * guess.omega)


class FitPath:
    """Moments of a fit of ``problem``, from when this is made: when it must end, and what it answers.

    ``losses`` holds one a moment, NaN where the package does not give it; ``steps`` counts the calls of :meth:`step`.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem, self.began = problem, time.process_time()
        self.seconds: list[float] = []
        self.logs: list[tuple[float, float]] = []
        self.losses: list[float] = []
        self.steps = 0
        self._until, self._most = np.inf, 0

    def stage(self, seconds: float, most: int) -> None:
        """Begin a stage of at most so many seconds of processor time, and ``most`` steps (0: any number)."""
        self._until = time.process_time() + seconds
        self._most = self.steps + most if most else 0

    def step(self, now: Callable[[], Now], steps: int = 1) -> bool:
        """Count steps of the optimiser, note where it is if it is time to; returns True where the stage must end."""
        self.steps += steps
        clock = time.process_time()
        if not self.seconds or clock - self.began >= SPACING * self.seconds[-1]:
            self.note(*now())
        return clock >= self._until or bool(self._most and self.steps >= self._most)

    def note(self, log_stiffness: float, log_damping: float, loss: float) -> None:
        """Keep this moment, and report it as the best answer so far."""
        self.seconds.append(time.process_time() - self.began)
        self.logs.append((log_stiffness, log_damping))
        self.losses.append(loss)
        report_progress(self.problem, self._answer)

    def end(self, now: Now, layers: Layers, duration: float) -> Estimate:
        """Return the answer where the fit stands; raises NoEstimate where it is not finite."""
        if not np.all(np.isfinite(now[:2])) or not all(np.all(np.isfinite(part)) for own in layers for part in own):
            sentence = "its training ran to numbers that are not finite; try another seed, or a record with less noise"
            raise NoEstimate(sentence, cost=Cost(self.steps, self.steps))
        self.note(*now)
        return self._answer((NetworkResponse(tuple(layers), duration),), f"loss {now[2]:.3g} after {self.steps} steps")

    def _answer(self, responses: tuple[NetworkResponse, ...] = (), message: str = "") -> Estimate:
        """Return the last moment; the response simulated from it stands in where the network is not given."""
        system = self.problem.system
        logs = np.insert(np.array(self.logs), 0, 0.0, axis=1)  # the mass is 1
        kinds = [("mass", "stiffness", "damping").index(parameter.kind) for parameter in system.parameters]
        parameters = np.exp(logs[:, kinds])
        last = dict(zip(system.names, parameters[-1], strict=True))
        values = np.array([float(group.value(last)) for group in system.groups])
        return Estimate(
            system,
            groups=Normal(tuple(group.name for group in system.groups), values, covariance=None, log=False),
            reconstructions=responses,
            message=message,
            cost=Cost(self.steps, self.steps),
            traces={
                "path_cpu_s": np.array(self.seconds),
                "path_parameters": parameters,
                "path_loss": np.array(self.losses),
            },
            dimensions={"path_parameters": [parameter.dimension for parameter in system.parameters]},
        )


@dataclass(frozen=True)
class Rival(Identifier):
    """Train by ``adam_steps`` of Adam, then ``second_steps`` of a second optimiser (0: as many as there is time for).

    Neither stage takes more than its part of ``seconds`` of processor time, 30 % for Adam; a stage that the clock ends
    is not the same twice.
    """

    seconds: float = 120.0
    adam_steps: int = 3000
    second_steps: int = 3000

    scope: ClassVar[Scope] = Scope(forced=False, nonlinear=False)
    extra: ClassVar[str] = "rivals"
    works_in = "natural units"

    def __post_init__(self) -> None:
        if not (np.isfinite(self.seconds) and self.seconds > 0):
            raise InputError("method.seconds", self.seconds, "a positive number of seconds")
        for name in ("adam_steps", "second_steps"):
            if getattr(self, name) < 0:
                raise InputError(f"method.{name}", getattr(self, name), "a number of steps, 0 for no limit")

    def objection(self, problem: Problem) -> str | None:
        objection = super().objection(problem)
        if sorted(parameter.kind for parameter in problem.system.parameters) != ["damping", "mass", "stiffness"]:
            return objection or "it needs one mass, one damping and one stiffness"
        return objection

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Estimate the groups k/m and c/m, without uncertainty.

        Raises NoEstimate where the training runs to numbers that are not finite.
        """
        path = FitPath(problem)
        with quiet():
            return self.train(DecayRecord(problem), path, int(rng.integers(2**31)))

    @property
    def stages(self) -> tuple[float, float]:
        """Seconds of the two stages."""
        return ADAM_SHARE * self.seconds, (1.0 - ADAM_SHARE) * self.seconds

    @abstractmethod
    def train(self, decay: DecayRecord, path: FitPath, seed: int) -> Estimate:
        """Drive the package from the start to the answer."""


@dataclass(frozen=True)
class TorchRival(Rival):
    """One whose package computes with torch, on so many ``threads``."""

    threads: int = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.threads < 1:
            raise InputError("method.threads", self.threads, "at least 1")


def rival_card(title: str, training: str, version: str, order: int) -> Card:
    """Return the card of a package, trained as it ships."""
    return Card(
        summary=f"inverse PINN of the package {title}: tanh network, {training}",
        start="used when known",
        scale="groups",
        reconstruction="own",
        uncertainty="none: the package states none",
        settings_source=f"{version} as it ships; network and collocation of the paper; our start scan",
        title=title,
        order=order,
        remarks=True,
    )


def linear_layers(layers: Sequence[Any]) -> Layers:
    """Return the weights of torch's linear layers."""
    return [(layer.weight.detach().numpy().copy(), layer.bias.detach().numpy().copy()) for layer in layers]


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
def torch_set_up(threads: int, seed: int) -> Iterator[None]:
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
