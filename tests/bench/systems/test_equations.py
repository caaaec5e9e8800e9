"""The systems: equations by hand in every library, dimensions, and the groups that exact algebra finds."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bench import (
    Channel,
    InitialState,
    InputError,
    Problem,
    Record,
    Units,
    array_ops,
    numpy_ops,
    regression_columns,
    simulate,
)
from bench.config.experiment import expand
from bench.dynamics.mechanics import linear_matrices
from bench.information.fisher import compute_bound
from bench.information.structural import structure
from bench.scenario.scenario import Scenario
from bench.systems import (
    SDOF,
    BoucWen,
    Chain,
    Coulomb,
    Dimension,
    Duffing,
    Matrices,
    Pendulum,
    QuadraticDamping,
    RayleighChain,
    System,
    VanDerPol,
    make_system,
)

BAR = Matrices(mass=[[1, 1], [1, 2], [2, 2]], damping=[[1, 1], [2, 2]], stiffness=[[1, 1], [1, 2, -1], [2, 2]])
SYSTEMS: dict[str, System] = {
    "sdof": SDOF(),
    "duffing": Duffing(),
    "chain": Chain(3),
    "quadratic_damping": QuadraticDamping(),
    "coulomb": Coulomb(0.3),
    "van_der_pol": VanDerPol(),
    "pendulum": Pendulum(),
    "bouc_wen": BoucWen(),
    "bouc_wen_2": BoucWen(2),
    "bouc_wen_1.5": BoucWen(1.5),
    "rayleigh_chain": RayleighChain(2),
    "matrices": BAR,
}
every_system = pytest.mark.parametrize("name", SYSTEMS)


def by_hand(name: str, p: dict[str, float], x: Any, v: Any, a: Any, f: Any, z: Any) -> tuple[list[float], list[float]]:
    """Equations of motion and rates of hidden states from the textbooks, in plain numbers."""
    if name == "chain":
        damping, stiffness = (
            np.array([[p[f"{s}1"] + p[f"{s}2"], -p[f"{s}2"], 0], [-p[f"{s}2"], p[f"{s}2"] + p[f"{s}3"], -p[f"{s}3"]],
                      [0, -p[f"{s}3"], p[f"{s}3"]]])
            for s in "ck"
        )  # fmt: skip
        return list(np.diag([p["m1"], p["m2"], p["m3"]]) @ a + damping @ v + stiffness @ x - f), []
    if name == "rayleigh_chain":
        mass = np.diag([p["m1"], p["m2"]])
        stiffness = np.array([[p["k1"] + p["k2"], -p["k2"]], [-p["k2"], p["k2"]]])
        damping = p["alpha"] * mass + p["beta"] * stiffness
        return list(mass @ a + damping @ v + stiffness @ x - f), []
    if name == "matrices":
        mass = np.array([[p["m11"], p["m12"]], [p["m12"], p["m22"]]])
        stiffness = np.array([[p["k11"], -p["k12"]], [-p["k12"], p["k22"]]])
        return list(mass @ a + np.diag([p["c11"], p["c22"]]) @ v + stiffness @ x - f), []
    y, u = float(x[0]), float(v[0])
    inertia = p["m"] * a[0] - f[0]
    if name in ("sdof", "duffing"):
        return [inertia + p["c"] * u + p["k"] * y + p.get("k3", 0.0) * y**3], []
    if name == "quadratic_damping":
        return [inertia + p["c"] * u + math.copysign(p["c2"] * u**2, u) + p["k"] * y], []
    if name == "coulomb":
        return [inertia + p["c"] * u + p["mu"] * math.tanh(u / 0.3) + p["k"] * y], []
    if name == "van_der_pol":
        return [inertia - p["c"] * (1 - y**2 * p["c3"] / p["c"]) * u + p["k"] * y], []
    if name == "pendulum":
        return [inertia + p["c"] * u + p["k"] * p["l"] * math.sin(y / p["l"])], []
    n = {"bouc_wen": 1.0, "bouc_wen_2": 2.0, "bouc_wen_1.5": 1.5}[name]
    size = abs(z[0])
    rate = u - p["beta"] * abs(u) * size ** (n - 1) * z[0] - p["gamma"] * u * size**n
    return [inertia + p["c"] * u + p["k"] * y + p["kz"] * z[0]], [rate]


def drawn(system: System, seed: int = 7) -> tuple[dict[str, float], list[np.ndarray]]:
    """Random parameters and one random state x, v, a, f, z."""
    rng = np.random.default_rng(seed)
    p = {name: float(rng.uniform(0.5, 2.0)) for name in system.names}
    return p, [*rng.standard_normal((4, system.n_dof)), rng.standard_normal(system.n_hidden)]


def library(name: str) -> tuple[Any, Any, Any]:
    """Ops of a library, what makes a number its own, and what makes it a float again."""
    if name == "numpy":
        return numpy_ops, np.float64, float
    module = pytest.importorskip(name)
    if name == "jax":
        module.config.update("jax_enable_x64", True)
        return array_ops(module.numpy), module.numpy.asarray, float
    absolute = {"casadi": "fabs", "sympy": "Abs", "torch": "abs"}[name]
    functions = {key: getattr(module, key) for key in ("sin", "cos", "tanh", "exp")}
    ops = SimpleNamespace(**functions, abs=getattr(module, absolute))
    make = {"casadi": getattr(module, "DM", None), "sympy": getattr(module, "Float", None)}
    return ops, make.get(name) or (lambda value: module.tensor(float(value), dtype=module.float64)), float


@pytest.mark.parametrize("where", ["numpy", "jax", "torch", "casadi", "sympy"])
@every_system
def test_the_residual_is_the_textbooks_equation_in_every_library(name: str, where: str) -> None:
    system = SYSTEMS[name]
    ops, make, back = library(where)
    for seed in (7, 8):
        p, (x, v, a, f, z) = drawn(system, seed)
        own = {key: make(value) for key, value in p.items()}
        x_, v_, a_, f_, z_ = ([make(value) for value in part] for part in (x, v, a, f, z))
        residual = [back(r) for r in system.residual(own, x_, v_, a_, f_, z_, ops)]
        rates = [back(r) for r in system.hidden_rates(own, x_, v_, f_, z_, ops)]
        expected = by_hand(name, p, x, v, a, f, z)
        np.testing.assert_allclose(residual, expected[0], rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(rates, expected[1], rtol=1e-12, atol=1e-12)


@every_system
def test_every_term_is_a_force_and_options_with_a_dimension_follow_the_units(name: str) -> None:
    mass, length, time = 3.0, 5.0, 7.0

    def scale(d: Dimension) -> float:
        return mass**d.mass * length**d.length * time**d.time

    system = SYSTEMS[name]
    p, (x, v, a, f, z) = drawn(system)
    there = {parameter.name: p[parameter.name] / scale(parameter.dimension) for parameter in system.parameters}
    sizes = (length, length / time, length / time**2, mass * length / time**2, length)
    scaled = [part / size for part, size in zip((x, v, a, f, z), sizes, strict=True)]
    other = system.rescaled(scale)
    force = np.array(other.residual(there, *scaled, numpy_ops)) * mass * length / time**2
    rates = np.array(other.hidden_rates(there, scaled[0], scaled[1], scaled[3], scaled[4], numpy_ops)) * length / time
    expected = by_hand(name, p, x, v, a, f, z)
    np.testing.assert_allclose(force, expected[0], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(rates, expected[1], rtol=1e-12, atol=1e-12)


@every_system
def test_a_problem_in_other_units_has_the_same_response(name: str) -> None:
    system, units = SYSTEMS[name], Units(2.0, 0.1, 3.0)
    p, (x, v, *_) = drawn(system)
    times = np.linspace(0.0, 2.0, 9)
    start = InitialState(x, v)
    record = Record((Channel(times, np.zeros(9)),), initial_state=start)
    there = Problem(system, (record,)).expressed_in(units)
    scales = units.scales(system)
    own = there.records[0].initial_state
    assert own is not None
    scaled = simulate(there.system, {key: value / scales[key] for key, value in p.items()}, own, times / 3.0)
    here = simulate(system, p, start, times)
    np.testing.assert_allclose(scaled.displacement * 0.1, here.displacement, rtol=1e-6, atol=1e-6)


@every_system
def test_affine_in_the_parameters_is_as_declared(name: str) -> None:
    """The second difference of an affine function vanishes along every direction of the parameters."""
    system = SYSTEMS[name]
    p, (x, v, a, f, z) = drawn(system)
    q, _ = drawn(system, 9)
    along = [{key: p[key] + s * q[key] for key in p} for s in (0.0, 1.0, 2.0)]
    r = [np.array(system.residual(own, x, v, a, f, z, numpy_ops)) for own in along]
    assert np.allclose(r[0] - 2 * r[1] + r[2], 0.0, atol=1e-12) == system.affine_in_parameters
    if system.affine_in_parameters and not system.n_hidden:
        columns, offset = regression_columns(system, x[:, None], v[:, None], a[:, None], f[:, None])
        np.testing.assert_allclose(columns @ np.array(list(p.values())) + offset, r[0], atol=1e-12)


SMOOTH = [name for name in SYSTEMS if not name.startswith("bouc_wen")]


@pytest.mark.parametrize("name", SMOOTH)
def test_free_vibration_tells_the_declared_groups_by_exact_algebra(name: str) -> None:
    """Taylor coefficients in rational arithmetic (no integrator): every group is told and there are no more."""
    system = SYSTEMS[name]
    for told in ("known", "unknown"):
        found = structure(system, None, told)
        assert found.rank == len(system.groups)
        assert all(found.identifiable(group) for group in system.groups)
        assert found.identifiable(system.quantity(system.gauge)) is False


@pytest.mark.parametrize("name", SMOOTH)
def test_a_force_tells_everything_by_exact_algebra(name: str) -> None:
    system = SYSTEMS[name]
    assert structure(system, None, "known", (0,)).rank == len(system.names)


@pytest.mark.parametrize("exponent", [1, 2])
def test_before_the_first_reversal_hysteresis_tells_but_the_sum_of_its_two_exponents(exponent: int) -> None:
    """From z = 0, z and x' have one sign until x' turns: ``beta |x'| |z|^(n-1) z + gamma x' |z|^n`` is the sum's alone.

    A Taylor series at the start knows no more; that the whole record tells both is the Fisher information's to say.
    """
    found = structure(BoucWen(exponent))
    assert found.rank == 4
    assert {group.name for group in found.groups} == {"k_over_m", "c_over_m", "kz_over_m"}


CONF = ["quadratic_damping", "coulomb", "van_der_pol", "pendulum", "bouc_wen", "rayleigh_chain"]


@pytest.mark.parametrize("name", CONF)
def test_free_vibration_tells_the_declared_groups_at_the_configured_scenario(name: str) -> None:
    """The null space of the Fisher information is what is orthogonal to the groups; at 20 dB each is told to 25 %."""
    (job,) = expand(["method=oracle", f"system={name}", "prior=none", "initial_state=unknown"], False)
    scenario = replace(job.scenario, dense=job.scenario.samples, forecast=0.5)
    system, bound = scenario.make_system(), compute_bound(scenario)
    null = np.array(bound.null_space)
    groups = np.array([group.vector(system.names) for group in system.groups])
    assert len(null) == 1
    assert np.linalg.matrix_rank(groups) == len(system.names) - 1
    np.testing.assert_allclose(groups @ null[0], 0.0, atol=1e-5)
    assert max(bound.relative_sd[group.name] for group in system.groups) < 0.25
    p = len(system.groups) + 2 * system.n_dof  # on the samples: the trace of a projection on p columns
    if system.n_dof == 1:
        assert bound.rmse == pytest.approx(scenario.sigmas(0)[0] * np.sqrt(p / scenario.samples), rel=1e-5)


@pytest.mark.parametrize("name", ["chain5", "rayleigh_chain", "matrices", "coulomb", "bouc_wen"])
def test_a_record_has_four_samples_in_the_shortest_period(name: str) -> None:
    """Of a linear system from its matrices, of the others from the stiffness of small motion."""
    (cell,) = [job.cell() for job in expand(["method=oracle", f"system={name}"], False)]
    scenario: Scenario = cell.scenario
    system, p = scenario.make_system(), scenario.parameters
    if system.linear:
        mass, _, stiffness = linear_matrices(system, p)
        fastest = float(np.sqrt(np.max(np.linalg.eigvals(np.linalg.solve(mass, stiffness)).real)))
    else:
        fastest = math.sqrt((p["k"] + p.get("kz", 0.0)) / p["m"])
    assert 2 * math.pi / fastest >= 4 * scenario.duration / (scenario.samples - 1)


def test_rayleigh_damping_ratios_are_the_textbooks() -> None:
    """``zeta = alpha / 2w + beta w / 2`` mode by mode (Inman, equation 4.124)."""
    p = {"m1": 1.0, "m2": 0.7, "m3": 1.3, "k1": 20.0, "k2": 15.0, "k3": 18.0, "alpha": 0.2, "beta": 0.01}
    mass, damping, stiffness = linear_matrices(RayleighChain(3), p)
    squares, shapes = np.linalg.eig(np.linalg.solve(mass, stiffness))
    w = np.sqrt(squares)
    modal = np.diag(shapes.T @ damping @ shapes) / np.diag(shapes.T @ mass @ shapes)
    np.testing.assert_allclose(modal / (2 * w), 0.2 / (2 * w) + 0.01 * w / 2, rtol=1e-10)


@pytest.mark.parametrize(
    ("name", "options", "part"),
    [
        ("coulomb", {"smoothing_velocity": 0.0}, "smoothing_velocity"),
        ("bouc_wen", {"exponent": 0.5}, "exponent"),
        ("rayleigh_chain", {"n": 0}, "one mass"),
        ("matrices", {"mass": [[1, 1], [3, 3]]}, "needs a mass"),
        ("matrices", {"mass": [[1, 1], [1, 1, -1]]}, "diagonal"),
        ("matrices", {"mass": [[1, 1]], "damping": [[1, 1], [1, 1]]}, "repeated"),
        ("matrices", {"mass": [[1, 1], [2, 2]], "damping": [[1, 1]], "stiffness": [[2, 2]]}, "uncoupled"),
        ("matrices", {"mass": [[1]]}, "row"),
    ],
)
def test_invalid_options_raise_one_line(name: str, options: dict[str, Any], part: str) -> None:
    with pytest.raises(InputError, match=part) as caught:
        make_system(name, options)
    assert len(str(caught.value).splitlines()) == 1
