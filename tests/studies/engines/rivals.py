"""Other people's engines on the data and from the starts of ours; run as a child: ``-m tests.studies.engines.rivals``.

Each fits damping and stiffness of one mass, the mass and the start being told, to displacements alone: plain residuals,
no prior, as one writes it. The starts: what the scan of this benchmark gives, and the nominal values.
"""

from __future__ import annotations

import importlib.util
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench import OutputError, Problem
from bench.config.experiment import expand
from bench.entrants.registry import make_method
from methods.starts.candidates import candidates
from tests.studies.engines.row import METHOD_STREAM, answer, begin

STEPS = 4
"""Runge-Kutta steps from one sample to the next, in the multiple shooting."""
STARTS = ("scan", "nominal")


@dataclass(frozen=True)
class Data:
    """One record: times, displacements, the state at time 0, and the mass that it is fitted with."""

    times: np.ndarray
    values: np.ndarray
    state: np.ndarray
    mass: float

    def residuals(self, c: float, k: float) -> np.ndarray:
        """Simulated less measured displacement, by scipy's defaults at a relative tolerance of 1e-6."""
        from scipy.integrate import solve_ivp

        def rates(t: float, z: np.ndarray) -> list[float]:
            return [z[1], -(c * z[1] + k * z[0]) / self.mass]

        found = solve_ivp(rates, (0.0, self.times[-1]), self.state, t_eval=self.times, rtol=1e-6)
        return np.asarray(found.y[0] - self.values) if found.success else np.full(self.times.size, 1e3)


Rival = Callable[[Data, float, float], tuple[float, float]]
"""Damping and stiffness, from those to start at."""


def by_scipy(data: Data, c: float, k: float) -> tuple[float, float]:
    """``scipy.optimize.least_squares`` around ``solve_ivp``."""
    from scipy.optimize import least_squares

    found = least_squares(lambda x: data.residuals(c * x[0], k * x[1]), [1.0, 1.0], bounds=(0.0, np.inf)).x
    return c * found[0], k * found[1]


def by_lmfit(data: Data, c: float, k: float) -> tuple[float, float]:
    """``lmfit.minimize`` around ``solve_ivp``."""
    import lmfit

    start = lmfit.Parameters()
    start.add("c", value=c, min=0.0)
    start.add("k", value=k, min=0.0)
    found = lmfit.minimize(lambda p: data.residuals(p["c"].value, p["k"].value), start).params
    return float(found["c"].value), float(found["k"].value)


def by_pypesto(data: Data, c: float, k: float) -> tuple[float, float]:
    """pyPESTO's least squares around ``solve_ivp``, over logarithms, with finite differences of its own."""
    import pypesto
    from pypesto import optimize

    def residuals(logs: np.ndarray) -> np.ndarray:
        return data.residuals(*np.exp(logs))

    start = np.log(np.array([c, k]))
    objective = pypesto.FD(pypesto.Objective(res=residuals), grad=False, hess=False, sres=True)
    problem = pypesto.Problem(objective, lb=start - 7.0, ub=start + 7.0, x_guesses=[start])
    optimizer = optimize.ScipyOptimizer(method="ls_trf")
    found = optimize.minimize(problem, optimizer=optimizer, n_starts=1, progress_bar=False).optimize_result[0].x
    return float(np.exp(found[0])), float(np.exp(found[1]))


def by_pybop(data: Data, c: float, k: float) -> tuple[float, float]:
    """PyBOP, a simulator of one's own around ``solve_ivp``: least squares by its defaults, in units of the start."""
    import pybop

    class Oscillator(pybop.BaseSimulator):
        def solve_batch(self, inputs: Any, calculate_sensitivities: bool = False) -> Any:
            return [self.solution(own) for own in inputs]

        def solution(self, own: Any) -> Any:
            found, x = pybop.Solution(own), data.residuals(c * own["c"], k * own["k"]) + data.values
            found.set_solution_variable("x", x)
            return found

    unknowns = {name: pybop.Parameter(bounds=(1e-3, 1e3), initial_value=1.0) for name in ("c", "k")}
    record = pybop.Dataset({"Time [s]": data.times, "x": data.values}, control_functions=[])
    problem = pybop.Problem(Oscillator(unknowns), pybop.SumSquaredError(record, target="x"))
    found = pybop.SciPyMinimize(problem).run().x
    return c * float(found[0]), k * float(found[1])


def by_casadi(data: Data, c: float, k: float) -> tuple[float, float]:
    """Multiple shooting with CasADi's ``Opti`` and IPOPT: a state a sample, joined by Runge-Kutta steps."""
    import casadi as ca

    opti = ca.Opti()
    p, z = opti.variable(2), opti.variable(2, data.times.size)

    def rates(state: Any) -> Any:
        return ca.vertcat(state[1], -(p[0] * state[1] + p[1] * state[0]) / data.mass)

    for i, interval in enumerate(np.diff(data.times)):
        state, h = z[:, i], interval / STEPS
        for _ in range(STEPS):
            k1 = rates(state)
            k2 = rates(state + h / 2 * k1)
            k3 = rates(state + h / 2 * k2)
            k4 = rates(state + h * k3)
            state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        opti.subject_to(z[:, i + 1] == state)
    opti.subject_to(z[:, 0] == data.state)
    opti.subject_to(p > 0)
    opti.minimize(ca.sumsqr(z[0, :].T - data.values))
    opti.set_initial(p, [c, k])
    opti.set_initial(z[0, :], data.values)
    opti.set_initial(z[1, :], np.gradient(data.values, data.times))
    opti.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes"})
    found: Any = opti.solve().value(p)
    return float(found[0]), float(found[1])


RIVALS: dict[str, tuple[str, str, Rival]] = {
    "scipy": ("scipy", "`scipy.optimize.least_squares` around `solve_ivp`", by_scipy),
    "lmfit": ("lmfit", "`lmfit.minimize` around `solve_ivp`", by_lmfit),
    "pypesto": ("pypesto", "pyPESTO, `ls_trf` around `solve_ivp`", by_pypesto),
    "pybop": ("pybop", "PyBOP, `SciPyMinimize` around `solve_ivp`", by_pybop),
    "casadi": ("casadi", "CasADi: multiple shooting by `Opti` and IPOPT", by_casadi),
}
"""By name: the package, the title, the fit."""
SOLVED = 0.5
"""An answer within so many of our standard errors of ours counts as the same minimum: ours has a wide prior besides."""


def data_of(problem: Problem) -> Data:
    """Return the data for a rival: a weighed mass is taken as it is stated."""
    (record,), prior = problem.records, problem.prior
    assert prior is not None
    assert record.initial_state is not None
    state = np.concatenate([record.initial_state.displacement, record.initial_state.velocity])
    return Data(record.channels[0].times, record.channels[0].values, state, prior.nominal["m"])


def start_of(problem: Problem, kind: str, mass: float) -> tuple[float, float]:
    """Damping and stiffness to start at: of the scan's best candidate in proportion to the mass, or as stated."""
    assert problem.prior is not None
    p = problem.prior.nominal
    if kind == "scan":
        units = problem.natural_units()
        found = candidates(OutputError(problem.expressed_in(units)), 4)[0]
        scale = units.scales(problem.system)
        p = {name: value * scale[name] for name, value in found.items()}
    return mass * p["c"] / p["m"], mass * p["k"] / p["m"]


def run(task: dict[str, Any]) -> dict[str, Any]:
    """Fit data sets one by one, each several times: least seconds, and distance from our own answer."""
    package, _, fit = RIVALS[task["rival"]]
    if importlib.util.find_spec(package) is None:
        return {"missing": package}
    scenario = expand(["method=prior", "system=sdof"], multirun=False)[0].scenario
    make, ours, seconds, off = scenario.maker(task["seed"]), make_method("shooting", {}), [], []
    for i in range(-1, task["sets"]):  # the one before the first imports what is needed
        problem = make(i % task["sets"])[0]
        data, own = data_of(problem), ours.identify(problem, np.random.default_rng([METHOD_STREAM, i + 1]))
        start, times = start_of(problem, task["start"], data.mass), []
        for _ in range(task["repeats"]):
            begin()
            began = time.process_time()
            try:
                c, k = fit(data, *start)
            except RuntimeError:  # IPOPT found no way
                c = k = float("nan")
            times.append(time.process_time() - began)
        if i >= 0:
            seconds.append(min(times))
            off.append(distance(own, {"c_over_m": c / data.mass, "k_over_m": k / data.mass}))
    return {"seconds": seconds, "off": off}


def distance(own: Any, found: dict[str, float]) -> float:
    """The larger difference of a ratio from our own, in standard deviations of that (a normal's, of its interval)."""
    off = []
    for group in own.system.groups:
        low, high = own.marginal(group).interval(0.95)
        off.append(abs(np.log(found[group.name] / own.marginal(group).value)) / (np.log(high / low) / 3.92))
    return float(np.max(off))


if __name__ == "__main__":
    sys.exit(answer(run))
