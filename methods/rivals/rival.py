"""Common parts of the three packages: settings, the scaled problem, the path and the end of a fit.

The problem is one free decay in natural units, with time scaled to -1 ... 1. With ``s = 2 t / duration - 1`` and omega
the frequency of the initial guess, the equation of motion over omega² is

    ``(rate / omega)² u'' + (c/m / omega) (rate / omega) u' + (k/m / omega²) u = 0``,  ``rate = 2 / duration``,

so that its mean square is of order one, like that of the data, and has the weight 1 in the loss; so has a known initial
state, as ``u(-1) = x0`` and ``rate u'(-1) / omega = v0 / omega``. The initial guess is that of :mod:`methods.pinn`.
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
"""Number of collocation points, evenly spaced over the record, including its ends."""
HIDDEN = (64, 64)
"""Units of the hidden layers."""
ADAM_RATE = 1e-3
ADAM_SHARE = 0.3
"""Share of the processor time of the training; the second optimiser has the rest."""
SPACING = 1.035
"""Least ratio of the processor times of successive entries of the path."""
LOGGERS = ("lightning", "lightning.pytorch", "lightning.fabric", "lightning_utilities", "jax", "pytorch_lightning")
"""Loggers of the packages and their dependencies, which write to standard error."""

Layers = Sequence[tuple[np.ndarray, np.ndarray]]
"""Weights (n_out, n_in) and biases (n_out,) of each layer."""
Now = tuple[float, float, float]
"""log(k/m), log(c/m) and the loss."""


class DecayRecord:
    """The record of a problem, rounded to ten decimals, and the initial guess from the best wave of the scan.

    ``times`` (n,) from -1 to 1, ``values`` (n,); ``known_start``: (x0, v0 / omega) or None. ``logs``: initial log(k/m)
    and log(c/m); ``units``: log(omega²) and log(omega), subtracted in the equation; ``speed``: rate over omega.
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
    """The history of a fit of ``problem`` from its creation, its limits, and its estimate.

    ``losses``: loss of each entry, NaN where the package does not provide it. ``steps``: number of steps.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem, self.began = problem, time.process_time()
        self.seconds: list[float] = []
        self.logs: list[tuple[float, float]] = []
        self.losses: list[float] = []
        self.steps = 0
        self._until, self._most = np.inf, 0

    def stage(self, seconds: float, most: int) -> None:
        """Begin a stage of at most ``seconds`` of processor time and ``most`` steps (0: any number)."""
        self._until = time.process_time() + seconds
        self._most = self.steps + most if most else 0

    def step(self, now: Callable[[], Now], steps: int = 1) -> bool:
        """Count steps of the optimiser and record an entry if due; return True where the stage must end."""
        self.steps += steps
        clock = time.process_time()
        if not self.seconds or clock - self.began >= SPACING * self.seconds[-1]:
            self.record(*now())
        return clock >= self._until or bool(self._most and self.steps >= self._most)

    def record(self, log_stiffness: float, log_damping: float, loss: float) -> None:
        """Record an entry, and report it as the current estimate."""
        self.seconds.append(time.process_time() - self.began)
        self.logs.append((log_stiffness, log_damping))
        self.losses.append(loss)
        report_progress(self.problem, self._answer)

    def end(self, now: Now, layers: Layers, duration: float) -> Estimate:
        """Return the final estimate; raises NoEstimate where it is not finite."""
        if not np.all(np.isfinite(now[:2])) or not all(np.all(np.isfinite(part)) for layer in layers for part in layer):
            sentence = "the training diverged; try another seed, or a record with less noise"
            raise NoEstimate(sentence, cost=Cost(self.steps, self.steps))
        self.record(*now)
        return self._answer((NetworkResponse(tuple(layers), duration),), f"loss {now[2]:.3g} after {self.steps} steps")

    def _answer(self, responses: tuple[NetworkResponse, ...] = (), message: str = "") -> Estimate:
        """Return the estimate of the last entry; without a network, the reconstruction is simulated."""
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
    """Train by ``adam_steps`` of Adam, then ``second_steps`` of a second optimiser (0: no limit of steps).

    The stages are limited to 30 % and 70 % of ``seconds`` of processor time; a stage ended by this limit is not
    reproducible.
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
            return objection or "it requires one mass, one damping and one stiffness"
        return objection

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Estimate the groups k/m and c/m, without uncertainty.

        Raises NoEstimate where the training diverges.
        """
        path = FitPath(problem)
        with quiet():
            return self.train(DecayRecord(problem), path, int(rng.integers(2**31)))

    @property
    def stages(self) -> tuple[float, float]:
        """Return the seconds of the two stages."""
        return ADAM_SHARE * self.seconds, (1.0 - ADAM_SHARE) * self.seconds

    @abstractmethod
    def train(self, decay: DecayRecord, path: FitPath, seed: int) -> Estimate:
        """Train the package's model from the initial guess; return the estimate."""


@dataclass(frozen=True)
class TorchRival(Rival):
    """A rival whose package uses torch with ``threads`` threads."""

    threads: int = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.threads < 1:
            raise InputError("method.threads", self.threads, "at least 1")


def rival_card(title: str, training: str, version: str, order: int) -> Card:
    """Return the card of a package with its default training."""
    return Card(
        summary=f"inverse PINN of the package {title}: tanh network, {training}",
        start="used when known",
        scale="groups",
        reconstruction="own",
        uncertainty="none: the package gives none",
        settings_source=f"defaults of {version}; network and collocation of the paper; initial guesses of the PINN",
        title=title,
        order=order,
        remarks=True,
    )


def linear_layers(layers: Sequence[Any]) -> Layers:
    """Return the weights of torch's linear layers."""
    return [(layer.weight.detach().numpy().copy(), layer.bias.detach().numpy().copy()) for layer in layers]


@contextmanager
def quiet() -> Iterator[None]:
    """Suppress output, warnings and logging below the level of an error."""
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
            warnings.formatwarning = shown  # PINA replaces it
            for logger, level in zip(loggers, levels, strict=True):
                logger.setLevel(level)


@contextmanager
def torch_set_up(threads: int, seed: int) -> Iterator[None]:
    """Run torch on the CPU in double precision with a seed; restore its settings and all random states."""
    import torch

    before = torch.get_num_threads(), torch.get_default_dtype(), torch.get_default_device()
    states = random.getstate(), np.random.get_state()  # noqa: NPY002 - restored for other code
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
