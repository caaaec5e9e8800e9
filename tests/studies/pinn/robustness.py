"""Accuracy of the PINN, and whether different weights, starting values and budgets lead to the same minimum."""

from __future__ import annotations

import time
from itertools import product

import numpy as np

from bench import Identifier, Problem
from bench.entrants.registry import make_method
from methods.pinn.method import PINN
from methods.pinn.physics import PhysicsInformed
from methods.pinn.task import Task
from methods.starts.waves import Guess
from tests.studies.common import scenario, tracked
from tests.studies.pinn.common import SEED, Part, compare, trials

SNRS = (40, 30, 20, 10, 5)


def accuracy(replicates: int) -> Part:
    """Root mean square errors over the oracle's on the same data, and over the bound."""
    rows = []
    for name, told, snr in tracked(list(product(("pinn", "collocation"), ("known", "unknown"), SNRS)), "scenario"):
        cell = scenario(system="sdof", snr=snr, initial_state=told)
        found = compare(make_method(name, {}), trials(cell, replicates))
        over_oracle = [f"{value:.3f}" for value in found.over_oracle]
        over_bound = [f"{value:.2f}" for value in found.over_bound]
        ok = f"{replicates - found.failed}/{replicates}"
        rows.append([name, told, str(snr), *over_oracle, *over_bound, f"{found.seconds:.3f}", ok])
    columns = ["method", "start", "SNR (dB)", "rmse / oracle", "k/m / oracle", "c/m / oracle"]
    columns += ["rmse / bound", "k/m / bound", "c/m / bound", "CPU s a fit", "ok"]
    text = (
        f"Root mean square errors over {replicates} data sets of the reference system (seed {SEED}, in no table), "
        "divided by those of the oracle (maximum a posteriori from the truth) on the same data, and by the bound. "
        f"The second has a sampling error of {100 / np.sqrt(2 * replicates):.0f} %."
    )
    return Part("accuracy", "Accuracy", text, columns, rows)


def systems(replicates: int) -> Part:
    """Two masses and the Duffing oscillator, 40 samples a channel at 30 dB."""
    rows = []
    cases = list(product(("pinn", "collocation"), ("chain2", "duffing"), ("known", "unknown")))
    for name, system, told in tracked(cases, "scenario"):
        cell = scenario(system=system, snr=30, initial_state=told)
        # no oracle here: for a nonlinear system it takes longer than the fit
        found = compare(make_method(name, {}), trials(cell, replicates, oracle=False))
        worst = int(np.argmax(found.over_bound))
        worst_name = found.names[worst].removesuffix("_error_pct")
        ok = f"{replicates - found.failed}/{replicates}"
        excess = [f"{found.over_bound[0]:.2f}", f"{found.over_bound[worst]:.2f} ({worst_name})"]
        rows.append([name, system, told, *excess, f"{found.seconds:.2f}", ok])
    columns = ["method", "system", "start", "rmse / bound", "largest excess", "CPU s a fit", "ok"]
    text = f"{replicates} data sets each, seed {SEED}; excess is the root mean square error over the bound."
    return Part("systems", "Two masses, and a nonlinear spring", text, columns, rows)


def initialisations(n: int) -> Part:
    """The same data set from different random weights."""
    rows = []
    for name, method in (("pinn", PINN()), ("pinn, start=exact", PINN(start="exact", iterations=150))):
        problem, _ = scenario(system="sdof", snr=20).replicates(SEED, 1)[0]
        values = []
        for i in tracked(range(n), "fit"):
            estimate = method.identify(problem, np.random.default_rng([SEED, i]))
            marginal = estimate.marginal(problem.system.quantity("k_over_m"))
            values.append(marginal.value if marginal else np.nan)
        off = np.abs(np.array(values) / np.median(values) - 1.0)
        low, high = marginal.interval(0.95) if marginal else (np.nan, np.nan)
        spread = f"{off.max():.1e}"
        rows.append(
            [name, str(n), str(int(np.sum(off <= 1e-4))), spread, f"{(high - low) / 2 / np.median(values):.1e}"]
        )
    columns = ["method", "initialisations", "k/m within 1e-4", "largest deviation", "half the 95 % interval"]
    text = "One data set at 20 dB, deviations of k/m from the median, relative; the interval is that of the noise."
    return Part("initialisations", "Different random weights", text, columns, rows)


def starting_values() -> Part:
    """From 20 x 10 starting values, k/m 0.5 to 40 and c/m 0.05 to 2, with and without the restarts."""
    rows = []
    problem, _ = scenario(system="sdof", snr=20).replicates(SEED, 1)[0]
    units = problem.natural_units()
    problem = problem.expressed_in(units)
    for name, method in (("pinn", PINN()), ("pinn, no restarts", PINN(restarts=0))):
        reference = _k_over_m(method, Task(problem, np.random.default_rng(0)))
        same, restarted = 0, 0
        starts = list(product(np.geomspace(0.5, 40.0, 20), np.geomspace(0.05, 2.0, 10)))
        for k, c in tracked(starts, "fit"):
            task = Task(problem, np.random.default_rng(SEED))
            omega, decay = np.sqrt(k) * units.time, 0.5 * c * units.time
            task.guesses.insert(0, Guess(omega, decay, 1.0))
            same += abs(_k_over_m(method, task) / reference - 1.0) < 1e-3
            restarted += len(task.fits) > 1
        rows.append([name, "200", str(same), str(restarted)])
    columns = ["method", "starting values", "the same minimum", "restarted"]
    text = "k/m from 0.5 to 40 and c/m from 0.05 to 2 (truth 8 and 0.4), 20 dB; the same minimum is k/m within 0.1 %."
    return Part("starting_values", "Different starting values", text, columns, rows)


def _k_over_m(method: PhysicsInformed, task: Task) -> float:
    method.attempt([task])
    best = task.best
    logs = dict(zip(task.problem.system.names, best.logs, strict=True)) if best else {"k": np.nan, "m": 0.0}
    return float(np.exp(logs["k"] - logs["m"]))


BUDGETS = (300, 1000, 3000, 10_000)
"""Steps of L-BFGS after the paper's Adam; the second is what ``pinn_adam`` is given."""


def steps(adam: dict[str, object]) -> Part:
    """Measure how far first-order training is from the minimum of its loss, by its number of steps."""
    rows = []
    for snr in (40, 20):
        problems = [problem for problem, _ in scenario(system="sdof", snr=snr).replicates(SEED, 3)]
        minima = [_log_k_over_m(make_method("pinn", {"slack": adam["slack"]}), problem)[:2] for problem in problems]
        for budget in tracked(BUDGETS, "budget"):
            method, off, ended, seconds = make_method("pinn", {**adam, "lbfgs_steps": budget}), [], 0, []
            for problem, (centre, sd) in zip(problems, minima, strict=True):
                value, _, message, spent = _log_k_over_m(method, problem)
                off.append(abs(value - centre) / sd)
                seconds.append(spent)
                ended += "number of steps" in message
            rows.append([f"{snr}", f"{budget:,}", f"{np.median(off):.2g}", f"{max(off):.2g}", f"{ended} of {len(off)}",
                         f"{np.median(seconds):.1f}"])  # fmt: skip
    columns = ["SNR (dB)", "steps of L-BFGS", "off by (median)", "off by (largest)", "ended at the limit"]
    columns.append("CPU s a fit")
    text = (
        "The paper's training, Adam and then L-BFGS, on three data sets of the reference system with known start: by "
        "how many standard errors its k/m is off the minimum of the same loss, which Levenberg-Marquardt finds."
    )
    return Part("steps", "What the steps of first-order training buy", text, columns, rows)


def _log_k_over_m(method: Identifier, problem: Problem) -> tuple[float, float, str, float]:
    """Log of k/m, its standard error, the message and the processor seconds of a fit."""
    started = time.process_time()
    estimate = method.identify(problem, np.random.default_rng(0))
    spent = time.process_time() - started
    marginal = estimate.marginal(problem.system.quantity("k_over_m"))
    assert marginal is not None
    low, high = np.log(marginal.interval(0.68))
    return float(np.log(marginal.value)), float(high - low) / 2.0, estimate.message, spent
