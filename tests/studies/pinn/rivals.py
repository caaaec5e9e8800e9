"""Side by side with other inverse PINNs, one core, in the same run: time to the minimum, and time of a fit.

The problem is the rivals' own: 25 samples at 20 dB of a free oscillator, 200 collocation points, a network 1-64-64-1,
trainable log(k/m) and log(c/m) from (4, 1), no start and no prior, and the loss ``mean data misfit² + 0.1 mean
residual²``. Every optimiser of this problem has the same minimum to find. The rival scripts are run where their folder
is given (``peers=``); DeepXDE where it is installed (``peer_python=`` names the interpreter that has it).
"""

from __future__ import annotations

import os
import re
import statistics
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from bench import Channel, Problem, Record
from bench.entrants.registry import make_method
from bench.scenario.truth import closed_form
from bench.systems import SDOF
from methods.pinn import levenberg
from methods.pinn.block import Spread
from methods.pinn.engine import torch_threads
from methods.pinn.levenberg import Walk
from methods.pinn.method import PINN
from methods.pinn.residuals import Residuals
from tests.studies.common import scenario
from tests.studies.pinn.common import Part

DURATION, SAMPLES, COLLOCATION, WEIGHT = 10.0, 25, 200, 0.1
FIRST = {"k": 4.0, "c": 1.0}
WITHIN = 0.01
"""Distance from the minimum, relative, within which a fit has reached it."""
ADAM, LBFGS = 10000, 3000


def rivals_data(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """The samples of one seed: times and values, (25,) each."""
    times = np.linspace(0.0, DURATION, SAMPLES)
    clean = closed_form({"m": 1.0, "c": 0.4, "k": 8.0}, 1.0, 0.0, times)
    sigma = np.sqrt(np.mean(clean**2) / 100.0)
    return times, clean + sigma * np.random.default_rng(seed).standard_normal(SAMPLES)


@dataclass
class Descent:
    """Losses of the rivals' problem against time (s)."""

    seconds: list[float]
    losses: list[float]
    k_over_m: float

    def time_to(self, loss: float) -> float:
        """When a loss was first reached; infinite if never."""
        return next((s for s, own in zip(self.seconds, self.losses, strict=True) if own <= loss), np.inf)


class _Watched(Walk):
    """A walk that notes the time and the rivals' loss of every accepted step."""

    def __init__(self, z: torch.Tensor, scale: float) -> None:
        super().__init__(z)
        self.scale, self.noted = scale, list[tuple[float, float]]()

    def record(self, who: np.ndarray, plain: torch.Tensor) -> None:
        data, physics = (part.square().mean().item() for part in plain[0].split([SAMPLES, COLLOCATION]))
        self.noted.append((time.perf_counter(), self.scale**2 * (data + WEIGHT * physics / DURATION**4)))


def descend(seed: int, rng: np.random.Generator, iterations: int, tolerance: float) -> Descent:
    """Levenberg-Marquardt on the rivals' loss: on the output layer with the parameters, then on all weights."""
    started = time.perf_counter()
    times, values = rivals_data(seed)
    scale = float(np.sqrt(np.mean(values**2)))
    problem = Problem(SDOF(), (Record((Channel(times / DURATION, values / scale),)),))
    logs = np.log([[1.0, FIRST["c"] * DURATION, FIRST["k"] * DURATION**2]])
    settings = PINN()
    cycles = np.array([np.sqrt(FIRST["k"]) * DURATION / (2.0 * np.pi)])
    with torch_threads(1), torch.no_grad():
        omega = 2.0 * np.pi * cycles
        residuals = Residuals([problem], lambda _, b: settings.ansatz(b, 0), COLLOCATION, ("c", "k"), logs, omega)
        # rows whose squared length is the rivals' loss: theirs are means, in metres and seconds
        data, physics = np.sqrt(SAMPLES) / scale, np.sqrt(COLLOCATION / WEIGHT) * DURATION**2 / scale
        one = np.ones(1)
        deviations = residuals.deviations(Spread(np.full((1, 1), data), physics * one, one, one, one))
        first = np.concatenate([settings.first_coefficients(1, 0, cycles, [rng]), logs[:, 1:]], 1)
        whole = torch.as_tensor(first)
        heads, short = residuals.heads(whole)
        walk = _Watched(short, scale)
        levenberg.minimise(heads, walk, deviations, 30, 1e-7)
        walk.z, walk.damping = residuals.with_heads(whole, walk.z), np.full(1, 1e-6)
        levenberg.minimise(residuals, walk, deviations, iterations, tolerance)
    parameters = np.exp(walk.z[0, -2:].numpy())
    seconds, losses = zip(*walk.noted, strict=True)
    return Descent([s - started for s in seconds], list(losses), parameters[1] / DURATION**2)


@dataclass
class Rival:
    """One fit of a rival script: seconds and the loss it ended at."""

    name: str
    seconds: float
    loss: float


def run_rivals(folder: Path, python: Path | None, seeds: int) -> list[Rival]:
    """The rival scripts over the seeds, one core and one thread."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "DDE_BACKEND": "pytorch"}
    commands = {"naive PyTorch": [sys.executable, "naive_fit.py", "f32", str(ADAM), str(seeds), str(LBFGS)]}
    if python:
        commands["DeepXDE"] = [str(python.absolute()), "dde_peer.py", "fit", "f32", str(ADAM), str(seeds), str(LBFGS)]
    found = []
    for name, command in commands.items():
        print(f"{name}: {seeds} fits, half a minute each ...", flush=True)
        output = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=True).stdout
        for line in output.splitlines():
            parts = re.findall(r"(?:adam \d+|\)) ([\d.]+)s", line)
            losses = re.findall(r"loss ([\d.e+-]+)", line)
            if parts and losses:
                found.append(Rival(name, sum(map(float, parts)), float(losses[-1])))
    return found


def shipped_seconds(name: str, settings: dict[str, object], fits: int) -> float:
    """Median seconds of a whole fit of a method as shipped, start-up apart, on the reference cell at 20 dB."""
    method, cell = make_method(name, settings), scenario(system="sdof", snr=20)
    seconds = []
    for i, (problem, _) in enumerate(cell.replicates(0, fits + 1)):
        started = time.perf_counter()
        method.identify(problem, np.random.default_rng(i))
        seconds.append(time.perf_counter() - started)
    return statistics.median(seconds[1:])


def rivals(folder: Path | None, python: Path | None, seeds: int, adam: dict[str, object]) -> Part:
    """The table of times, and ratios where the rivals could be run."""
    fits: list[Descent] = []
    minima = []
    descend(0, np.random.default_rng(0), 5, 1e-9)  # start-up
    for seed in range(seeds):
        longest = [descend(seed, np.random.default_rng([seed, i]), 400, 1e-12) for i in range(3)]
        minima.append(min(descent.losses[-1] for descent in longest))
        fits.append(descend(seed, np.random.default_rng([seed, 99]), 200, 1e-9))
    found = run_rivals(folder, python, seeds) if folder else []
    cases: list[tuple[str, str, dict[str, object], int]]
    cases = [("pinn", "pinn", {}, 20), ("collocation", "collocation", {}, 20), ("pinn_adam", "pinn", adam, 5)]
    shipped = {name: shipped_seconds(method, settings, n) for name, method, settings, n in cases}
    text = (
        "One core, one thread, medians; start-up and imports apart. Ratios compare whole fits: a rival's whole "
        "training with a fit to its end. The first line minimises the very loss of the rivals; the methods have "
        "losses of their own, with a start and a prior. The minimum is the lowest loss of three long "
        "Levenberg-Marquardt runs from other weights. A rival that ends more than 1 % above it never reached it."
    )
    columns = [
        "what", "whole fit (s)", "to within 1 % (s)", "above the minimum %", "naive PyTorch's whole fit",
        "DeepXDE's whole fit",
    ]  # fmt: skip
    return Part("rivals", "Time against other inverse PINNs", text, columns, lines(fits, minima, shipped, found))


def lines(
    fits: list[Descent], minima: list[float], shipped: dict[str, float], found: list[Rival]
) -> list[list[str]]:  # fmt: skip
    """The rows of the table: our optimiser on the rivals' loss, the methods as shipped (seconds), and the rivals."""
    whole = statistics.median(own.seconds[-1] for own in fits)
    near = statistics.median(own.time_to((1.0 + WITHIN) * least) for own, least in zip(fits, minima, strict=True))
    above = statistics.median(100.0 * (own.losses[-1] / least - 1.0) for own, least in zip(fits, minima, strict=True))
    reached = f"{near:.3f}" if np.isfinite(near) else "never reached"
    name = "their loss, Levenberg-Marquardt"
    rows = [[name, f"{whole:.3f}", reached, f"{above:.2f}", *_ratios(found, whole)]]
    for name, seconds in shipped.items():
        rows.append([f"method={name}", f"{seconds:.3f}", "-", "-", *_ratios(found, seconds)])
    for name in dict.fromkeys(rival.name for rival in found):
        runs = [rival for rival in found if rival.name == name]
        seconds = statistics.median(rival.seconds for rival in runs)
        over = [100.0 * (rival.loss / minimum - 1.0) for rival, minimum in zip(runs, minima, strict=True)]
        near_ones = sum(value <= 100.0 * WITHIN for value in over)
        # their scripts tell the loss at the end alone
        reached = f"at the end, {near_ones} of {len(runs)}" if near_ones else "never reached"
        label = f"{name}, Adam {ADAM} + L-BFGS"
        rows.append([label, f"{seconds:.2f}", reached, f"{statistics.median(over):.1f}", *_ratios(found, seconds)])
    return rows


def _ratios(found: list[Rival], seconds: float) -> list[str]:
    """Return the time of each rival's whole training over so many seconds of a whole fit."""
    ratios = []
    for name in ("naive PyTorch", "DeepXDE"):
        own = [rival.seconds for rival in found if rival.name == name]
        ratio = statistics.median(own) / seconds if own else np.nan
        ratios.append("not run" if np.isnan(ratio) else f"{ratio:,.0f} ×" if ratio >= 10 else f"{ratio:.2g} ×")
    return ratios
