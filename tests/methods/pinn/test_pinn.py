"""The PINN engine against autograd, explicit Jacobians, scipy's optimisers and exact solutions."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import BSpline
from scipy.optimize import least_squares, minimize

from bench import Channel, Estimate, Force, InitialState, Prior, Problem, Record, Status, System, simulate
from bench.contract import progress
from bench.contract.problem import Measures
from bench.systems import SDOF, BoucWen, Chain, Duffing
from methods.pinn import PINN
from methods.pinn.collocation import Collocation, local_functions
from methods.pinn.physics import PhysicsInformed
from methods.pinn.windows import Windows, WindowsResponse

torch = pytest.importorskip("torch")

from methods.network import tanh  # noqa: E402
from methods.network.ansatz import Ansatz, Basis, Local, SumAnsatz  # noqa: E402
from methods.network.tanh import Network  # noqa: E402
from methods.pinn import equations, levenberg  # noqa: E402
from methods.pinn.block import Block, Spread  # noqa: E402
from methods.pinn.residuals import Residuals  # noqa: E402

TRUE = {"m": 1.7, "c": 0.9, "k": 14.0}
PRIOR = Prior({"m": 1.68, "c": 1.5, "k": 9.0}, {"m": 0.02, "c": 1.0, "k": 0.5})


def layers(widths: tuple[int, ...], seed: int = 0) -> list[tuple[np.ndarray, np.ndarray]]:
    """A network with no zero weight."""
    rng = np.random.default_rng(seed)
    first = tanh.initial_layers(widths, 3.0, rng)
    return [*first[:-1], (rng.standard_normal(first[-1][0].shape), rng.standard_normal(first[-1][1].shape))]


def record(noise: float = 0.0, known: bool = False, n: int = 25, seed: int = 0) -> Record:
    times = np.linspace(0.0, 8.0, n)
    start = InitialState(np.array([0.6]), np.array([-0.8]))
    clean = simulate(SDOF(), TRUE, start, times).displacement[0]
    values = clean + noise * np.random.default_rng(seed).standard_normal(n)
    return Record((Channel(times, values),), (), start if known else None)


def networks(widths: tuple[int, ...]) -> Callable[[int, Block], Ansatz]:
    def make(_: int, block: Block) -> Network:
        tau = torch.as_tensor(2.0 * block.times / block.duration[:, None] - 1.0)
        return Network(widths, tau, torch.as_tensor(2.0 / block.duration))

    return make


def assisted(widths: tuple[int, ...]) -> Callable[[int, Block], Ansatz]:
    """A network plus fixed functions in the first record, a network alone in the other."""
    return lambda k, block: (
        SumAnsatz(networks(widths)(k, block), polynomials(k, block)) if k == 0 else networks(widths)(k, block)
    )


def polynomials(_: int, block: Block) -> Basis:
    """Powers of time up to the fourth, with their derivatives."""
    n = np.arange(5)
    t = block.times[..., None]
    streams = [t**n, n * t ** np.maximum(n - 1, 0), n * (n - 1) * t ** np.maximum(n - 2, 0)]
    return Basis(torch.as_tensor(np.stack(streams, 1)), block.n_paths)


def plain_problem(
    system: System | None = None, offset: bool = False, known: bool = True, seed: int = 1, scale: float = 1.0
) -> Problem:
    """Two records, every kind of channel, a force and a prior."""
    system = system or SDOF()
    n_dof, rng = system.n_dof, np.random.default_rng(seed)
    t = np.linspace(0.0, scale, 6)
    start = InitialState(rng.standard_normal(n_dof), rng.standard_normal(n_dof))
    kinds: tuple[Measures, ...] = ("displacement", "velocity", "acceleration")
    channels = tuple(Channel(t, rng.standard_normal(6), kind, n_dof - 1, offset=offset) for kind in kinds)
    force = Force(t, rng.standard_normal(6))
    records = (Record(channels, (force,), start if known else None), Record(channels[:1]))
    names = system.names
    return Problem(system, records, Prior(dict.fromkeys(names, 1.1), dict.fromkeys(names, 0.3)))


def spread(n_fits: int) -> Spread:
    first = np.ones(n_fits)
    return Spread(np.tile([0.1, 0.2, 0.3, 0.4], (n_fits, 1)), 5.0 * first, 2.0 * first, 0.05 * first, 0.5 * first)


def small(
    system: System | None = None,
    offset: bool = False,
    known: bool = True,
    exact: bool = False,
    ansatz: str = "network",
    n_fits: int = 1,
) -> tuple[Residuals, torch.Tensor, torch.Tensor]:
    """Residuals of different problems of one structure with a small ansatz; a point and deviations."""
    problems = [plain_problem(system, offset, known, seed, 1.0 + 0.2 * seed) for seed in range(n_fits)]
    names = problems[0].system.names
    widths = (1, 4, 3, 3, problems[0].system.n_dof + problems[0].system.n_hidden)
    residuals = Residuals(
        problems,
        {"network": networks(widths), "assisted": assisted(widths), "spline": polynomials}[ansatz],
        7,
        names,
        np.zeros((n_fits, len(names))),
        np.full(n_fits, 2.0),
        exact=exact,
    )
    z = 0.3 * np.random.default_rng(2).standard_normal((n_fits, residuals.n_z))
    if ansatz == "network":
        n = residuals.ansatzes[0].count
        for i in range(n_fits):
            z[i, : 2 * n] = np.concatenate([tanh.flat(layers(widths, 10 * i + k)) for k in range(2)])
    return residuals, torch.as_tensor(z), residuals.deviations(spread(n_fits))


@pytest.mark.parametrize("widths", [(1, 6, 2), (1, 6, 5, 1), (1, 4, 7, 3, 2)])
def test_streams_are_autograds_derivatives(widths: tuple[int, ...]) -> None:
    computed = layers(widths)
    times = torch.linspace(0.0, 3.0, 9, dtype=torch.float64, requires_grad=True)
    h = (times / 1.5 - 1.0)[:, None]
    for weight, bias in computed[:-1]:
        h = torch.tanh(h @ torch.as_tensor(weight).T + torch.as_tensor(bias))
    x = h @ torch.as_tensor(computed[-1][0]).T + torch.as_tensor(computed[-1][1])
    tau = (times / 1.5 - 1.0).detach()[None]
    ansatz = Network(widths, tau, torch.full((1,), 1 / 1.5, dtype=torch.float64))
    out = ansatz.forward(torch.as_tensor(tanh.flat(computed))[None]).output[0]
    for j in range(widths[-1]):
        (v,) = torch.autograd.grad(x[:, j].sum(), times, create_graph=True, retain_graph=True)
        (a,) = torch.autograd.grad(v.sum(), times, retain_graph=True)
        for stream, expected in enumerate((x[:, j], v, a)):
            torch.testing.assert_close(out[stream, :, j], expected.detach(), rtol=1e-11, atol=1e-11)


CASES: list[tuple[System, dict[str, Any]]] = [
    (SDOF(), {"offset": True}),
    (Duffing(), {"known": False}),
    (Chain(2), {}),
    (Chain(2), {"exact": True}),
    (SDOF(), {"ansatz": "spline", "offset": True}),
    (Chain(2), {"ansatz": "assisted"}),
    (SDOF(), {"ansatz": "assisted", "exact": True}),
    (Chain(2), {"ansatz": "spline", "exact": True}),
    (Duffing(), {"n_fits": 3}),
    (BoucWen(), {}),
    (BoucWen(exponent=2.0), {"known": False, "n_fits": 2}),
    (BoucWen(exponent=1.5), {"ansatz": "assisted"}),
]


@pytest.mark.parametrize(("system", "options"), CASES)
def test_jacobian_gradient_and_gram_agree_with_autograd(system: System, options: dict[str, Any]) -> None:
    """The reference is autograd over the vector written once more, with autograd's own derivatives by time."""
    residuals, z, deviations = small(system, **options)
    state = residuals.evaluate(z, deviations)
    linear = residuals.linearise(state, deviations)
    jacobian = torch.cat([part for _, part in residuals.jacobian_parts(state, linear)], 1)
    gram = residuals.gram(state, linear)
    same, gradient = residuals.gradient(z, deviations)
    torch.testing.assert_close(same.rows, state.rows)
    dual = torch.as_tensor(np.random.default_rng(3).standard_normal(state.rows.shape))
    pulled = residuals.pull_back(state, linear, dual)
    for i in range(residuals.n_fits):
        explicit = _autograd_jacobian(residuals.take(np.array([i])), z[i : i + 1], deviations[i : i + 1])
        scale = float(explicit.abs().max())
        assert float((jacobian[i] - explicit).abs().max()) < 1e-12 * scale
        torch.testing.assert_close(gradient[i], explicit.T @ state.rows[i], rtol=1e-11, atol=1e-11 * scale)
        torch.testing.assert_close(pulled[i], explicit.T @ dual[i], rtol=1e-11, atol=1e-11 * scale)
        expected = explicit @ explicit.T
        assert float((gram[i] - expected).abs().max()) < 1e-12 * float(expected.abs().max())


def _displacement(block: Block, ansatz: Ansatz, part: torch.Tensor, times: torch.Tensor) -> torch.Tensor:
    """The trainable function, (n_points, n_paths), written once more."""
    if isinstance(ansatz, SumAnsatz):
        computed, rest = part[:, : ansatz.inner.count], part[:, ansatz.inner.count :]
        return _displacement(block, ansatz.inner, computed, times) + _displacement(block, ansatz.fixed, rest, times)
    if isinstance(ansatz, Network):
        h = (2.0 * times[0] / float(block.duration[0]) - 1.0)[:, None]
        *hidden, last = tanh.layers_of(part, ansatz.widths)
        for weight, bias in hidden:
            h = torch.tanh(h @ weight[0].T + bias[0])
        return h @ last[0][0].T + last[1][0]
    powers = torch.stack([times[0] ** k for k in range(5)], -1)
    return powers @ part[0].unflatten(0, (block.n_paths, -1)).T


def _autograd_jacobian(residuals: Residuals, z: torch.Tensor, deviations: torch.Tensor) -> torch.Tensor:
    """Of one fit's residual vector."""
    z = z.clone().requires_grad_(True)
    parts, logs, offsets = residuals.split(z)
    outputs = []
    for block, ansatz, part in zip(residuals.blocks, residuals.ansatzes, parts, strict=True):
        times = torch.as_tensor(block.times[:1]).requires_grad_(True)
        x = _displacement(block, ansatz, part, times)
        if block.lift is not None:
            known = block.lift[0, :2, 0].detach()  # at time 0 the first part is the told start itself
            g = torch.exp(-((2.0 * times[0]) ** 2))[:, None]
            x = (known[0] + known[1] * times[0][:, None]) * g + (1.0 - g) * x
        streams = [x]
        for _ in range(2):
            slopes = [torch.autograd.grad(c.sum(), times, create_graph=True)[0][0] for c in streams[-1].unbind(-1)]
            streams.append(torch.stack(slopes, -1))
        outputs.append(torch.stack(streams)[None])
    rows = residuals.rows(outputs, logs, offsets)[0] / deviations[0]
    grads = [
        torch.autograd.grad(row, z, retain_graph=True, allow_unused=True, materialize_grads=True)[0][0] for row in rows
    ]
    return torch.stack(grads)


def test_exact_start_is_exact() -> None:
    residuals, z, deviations = small(exact=True)
    output = residuals.evaluate(z, deviations).outputs[0]
    known = plain_problem(seed=0).records[0].initial_state
    torch.testing.assert_close(output[0, :2, 0, 0], torch.tensor([known.displacement[0], known.velocity[0]]))
    assert residuals.n_rows == small()[0].n_rows - 2


def test_dual_and_primal_steps_are_the_textbook_step() -> None:
    residuals, z, deviations = small(n_fits=2)
    state = residuals.evaluate(z, deviations)
    linear = residuals.linearise(state, deviations)
    jacobian = torch.cat([part for _, part in residuals.jacobian_parts(state, linear)], 1)
    for kind in (equations.DualEquations, equations.PrimalEquations):
        normal = kind(residuals, state, deviations)
        torch.testing.assert_close(normal.size, (jacobian**2).sum(2).amax(1))
        damping = 1e-3 * normal.size
        steps, promised = normal.solve(damping)
        for i in range(2):
            j, r = jacobian[i], state.rows[i]
            stacked = torch.cat([j, damping[i].sqrt() * torch.eye(residuals.n_z, dtype=torch.float64)])
            right = torch.cat([r, torch.zeros(residuals.n_z, dtype=torch.float64)])
            step = torch.linalg.lstsq(stacked, right[:, None], driver="gelsd").solution[:, 0]
            assert float((steps[i] - step).norm() / step.norm()) < 1e-9
            left = r - j @ step
            assert float(promised[i]) == pytest.approx(0.5 * float(r @ r - left @ left), rel=1e-9)


def splines(system: System) -> tuple[Residuals, torch.Tensor, torch.Tensor]:
    """Residuals of two fits by quintic splines, at a random point."""
    problems = [plain_problem(system, True, False, seed, 1.0 + 0.2 * seed) for seed in range(2)]
    names, method = problems[0].system.names, Collocation(collocation=36)
    residuals = Residuals(
        problems, lambda _, block: method.ansatz(block, 1), 36, names, np.zeros((2, len(names))), np.full(2, 2.0)
    )
    z = torch.as_tensor(0.3 * np.random.default_rng(2).standard_normal((2, residuals.n_z)))
    return residuals, z, residuals.deviations(spread(2))


@pytest.mark.parametrize("system", [SDOF(), Chain(2), BoucWen()])
def test_bands_of_splines_are_the_dense_equations(system: System) -> None:
    residuals, z, deviations = splines(system)
    state = residuals.evaluate(z, deviations)
    banded, dense = (
        kind(residuals, state, deviations) for kind in (equations.BandedEquations, equations.PrimalEquations)
    )
    torch.testing.assert_close(banded.size, dense.size)
    torch.testing.assert_close(banded.trace, dense.trace)
    (step, promised), (expected, promise) = (item.solve(1e-3 * dense.size) for item in (banded, dense))
    torch.testing.assert_close(step, expected, rtol=1e-7, atol=1e-9)
    torch.testing.assert_close(promised, promise, rtol=1e-9, atol=0.0)
    item, other = banded.posterior(), dense.posterior()
    for part, wanted in zip([item.covariance, *item.variances], [other.covariance, *other.variances], strict=True):
        torch.testing.assert_close(part, wanted, rtol=1e-5, atol=1e-7 * float(wanted.abs().max()))


def test_a_long_record_keeps_its_memory_and_its_frequency() -> None:
    """20,000 samples over 500 cycles; the dense equations of its splines would take 100 MB, their inverse more."""
    times = np.linspace(0.0, 500.0, 20_000)
    clean = np.exp(-0.004 * times) * np.cos(2 * np.pi * 1.003 * times + 0.3)
    values = clean + 0.1 * np.random.default_rng(0).standard_normal(times.size)
    estimate = Collocation().identify(Problem(SDOF(), (Record((Channel(times, values),)),)), np.random.default_rng(0))
    marginal = estimate.marginal(SDOF().quantity("k_over_m"))
    true = (2 * np.pi * 1.003) ** 2 + 0.004**2
    low, high = marginal.interval(0.999)
    assert low < true < high
    assert high - low < 1e-3 * true


def test_windows_have_the_derivatives_of_their_response_and_a_constant() -> None:
    windows, duration = Windows((8, 8), 30), 30.0
    times = np.sort(np.random.default_rng(0).uniform(0.1, 29.9, 50))
    values, first = windows.local_functions(times, duration)
    coefficients = np.random.default_rng(1).standard_normal((1, windows.count))
    response = WindowsResponse(windows, coefficients, duration)
    places = first[:, None] + np.arange(values.shape[2])
    streams = np.einsum("stk,tk->st", values, coefficients[0, places])
    np.testing.assert_allclose(response(times)[0], streams[0], rtol=1e-12)
    h = 1e-4
    ahead, here, behind = (response(times + side)[0] for side in (h, 0.0, -h))
    np.testing.assert_allclose(streams[1], (ahead - behind) / (2 * h), atol=1e-5 * np.abs(streams[1]).max())
    np.testing.assert_allclose(streams[2], (ahead - 2 * here + behind) / h**2, atol=1e-4 * np.abs(streams[2]).max())
    design = np.zeros((times.size, windows.count))
    np.put_along_axis(design, places, values[0], 1)
    constant = np.linalg.lstsq(design, np.ones(times.size))[0]
    np.testing.assert_allclose(design @ constant, 1.0, atol=1e-8)


def test_a_long_record_in_windows_agrees_with_the_simulated_response() -> None:
    """Against scipy's least squares on the closed-form decay, at its own standard error."""
    times = np.linspace(0.0, 30.0, 220)
    rate, frequency, sigma = 0.04, 2 * np.pi * 1.02, 0.03

    def decay(z: np.ndarray) -> np.ndarray:
        return np.asarray(np.exp(-z[0] * times) * (z[2] * np.cos(z[1] * times) + z[3] * np.sin(z[1] * times)))

    values = decay(np.array([rate, frequency, 1.0, 0.2])) + sigma * np.random.default_rng(0).standard_normal(220)
    expected = least_squares(lambda z: (decay(z) - values) / sigma, [rate, frequency, 1.0, 0.2])
    sd = np.sqrt(np.diag(np.linalg.inv(expected.jac.T @ expected.jac)))
    estimate = PINN().identify(Problem(SDOF(), (Record((Channel(times, values),)),)), np.random.default_rng(0))
    stiffness, damping = (estimate.marginal(SDOF().quantity(name)) for name in ("k_over_m", "c_over_m"))
    assert damping.value / 2.0 == pytest.approx(expected.x[0], abs=0.3 * sd[0])
    computed = np.sqrt(stiffness.value - (damping.value / 2.0) ** 2)
    assert computed == pytest.approx(expected.x[1], abs=0.3 * sd[1])
    pickle.loads(pickle.dumps(estimate))


def test_heads_are_the_last_layers() -> None:
    residuals, z, deviations = small(Chain(2))
    heads, short = residuals.heads(z)
    torch.testing.assert_close(heads.evaluate(short, deviations).rows, residuals.evaluate(z, deviations).rows)
    moved = short + 0.1
    whole = residuals.with_heads(z, moved)
    torch.testing.assert_close(heads.evaluate(moved, deviations).rows, residuals.evaluate(whole, deviations).rows)
    n, last = residuals.ansatzes[0].count, 2 * (3 + 1)
    expected = np.concatenate(
        [np.r_[np.zeros(n - last, bool), np.ones(last, bool)]] * 2 + [np.ones(residuals.n_unknowns, bool)]
    )
    np.testing.assert_array_equal((whole != z).numpy()[0], expected)


def test_mixed_heads_have_orthonormal_columns_and_the_same_rows() -> None:
    residuals, z, deviations = small(Chain(2))
    heads, short = residuals.heads(z)
    mixed, coefficients = heads.mixed(short, deviations)
    rows = heads.evaluate(short, deviations).rows
    torch.testing.assert_close(mixed.evaluate(coefficients, deviations).rows, rows, rtol=1e-8, atol=1e-8)
    torch.testing.assert_close(mixed.unmixed(coefficients), short, rtol=1e-6, atol=1e-8)
    state = mixed.evaluate(coefficients, deviations)
    linear = mixed.linearise(state, deviations)
    jacobian = torch.cat([part for _, part in mixed.jacobian_parts(state, linear)], 1)
    computed = jacobian[0, :, : mixed.ansatzes[0].count]
    sizes = torch.linalg.svdvals(computed)
    assert bool(((sizes - 1.0).abs() < 1e-6).all())


@pytest.mark.slow
def test_levenberg_goes_lower_than_scipys_lbfgs() -> None:
    problem = Problem(SDOF(), (record(0.05, known=True),), PRIOR)
    scaled = problem.expressed_in(problem.natural_units())
    widths = (1, 12, 12, 1)
    residuals = Residuals([scaled], networks(widths), 60, SDOF().names, np.zeros((1, 3)), np.ones(1))
    weights = tanh.flat(tanh.initial_layers(widths, 3.6, np.random.default_rng(0)))
    z = torch.as_tensor(np.r_[weights, 0.0, np.log([6.0, 500.0])])[None]
    first = np.ones(1)
    deviations = residuals.deviations(
        Spread(np.full((1, 1), 0.1), 10.0 * first, 10.0 * first, 0.02 * first, 0.4 * first)
    )

    def loss(place: np.ndarray) -> tuple[float, np.ndarray]:
        state, gradient = residuals.gradient(torch.as_tensor(place[None]), deviations)
        return float(state.loss[0]), np.asarray(gradient[0])

    options = {"maxiter": 1000, "maxcor": 30, "ftol": 1e-12}
    computed = minimize(loss, z[0].numpy(), jac=True, method="L-BFGS-B", options=options)
    walk = levenberg.Walk(z)
    levenberg.minimise(residuals, walk, deviations, 150, 1e-6)
    reached = float(residuals.evaluate(walk.z, deviations).loss[0])
    assert reached <= computed.fun * (1 + 1e-3)
    assert computed.fun < 1e-2 * residuals.evaluate(z, deviations).loss[0]


@pytest.mark.parametrize("method", [PINN(), Collocation(), PINN(start="exact", iterations=150)])
def test_band_is_the_delta_methods(method: PhysicsInformed) -> None:
    """Against the sensitivities of the simulated response at scipy's solution, by finite differences."""
    sigma = 0.02
    computed = record(sigma, known=True, seed=3)
    estimate = method.identify(Problem(SDOF(), (computed,), PRIOR), np.random.default_rng(0))
    times = np.linspace(0.0, 8.0, 200)
    covariance = estimate.parameters.covariance
    logs = estimate.parameters.mean
    assert computed.initial_state is not None

    def path(point: np.ndarray) -> np.ndarray:
        p = dict(zip(SDOF().names, np.exp(point), strict=True))
        return simulate(SDOF(), p, computed.initial_state, times).displacement[0]

    slopes = np.stack([(path(logs + e) - path(logs - e)) / 2e-4 for e in 1e-4 * np.eye(3)], 1)
    expected = np.sqrt(np.einsum("ti,ij,tj->t", slopes, covariance, slopes))
    # the told start is kept to a tenth of the noise, the physics to a fifth of it: the band is that much wider
    np.testing.assert_allclose(estimate.bands[0](times)[0], expected, atol=0.25 * sigma)
    assert np.mean(np.abs(estimate.bands[0](times)[0] - expected)) < 0.05 * sigma


def test_bootstrap_spreads_as_the_linearisation_and_the_ensemble_hardly_at_all() -> None:
    """The network's initialisation is not where the error comes from: the paper's ensemble is far too sure."""
    problem = Problem(SDOF(), (record(0.05, known=True),), PRIOR)

    def deviation(method: PhysicsInformed) -> tuple[float, float]:
        estimate = method.identify(problem, np.random.default_rng(0))
        marginal = estimate.marginal(SDOF().quantity("k_over_m"))
        low, high = marginal.interval(0.68)
        return (high - low) / 2.0, float(np.mean(estimate.bands[0](np.linspace(1.0, 8.0, 50))))

    linearised = deviation(Collocation())
    bootstrap = deviation(Collocation(uncertainty="bootstrap", members=40, batch=40))
    ensemble = deviation(PINN(uncertainty="ensemble", members=4))
    assert bootstrap[0] == pytest.approx(linearised[0], rel=0.35)
    assert bootstrap[1] == pytest.approx(linearised[1], rel=0.35)
    assert ensemble[0] < 0.1 * linearised[0]
    assert ensemble[1] < 0.1 * linearised[1]


@pytest.mark.parametrize("known", [True, False])
def test_noise_free_record_gives_the_truth(known: bool) -> None:
    problem = Problem(SDOF(), (record(known=known),), PRIOR)
    estimate = PINN().identify(problem, np.random.default_rng(0))
    assert estimate.status is Status.OK
    for name, tolerance in (("k_over_m", 1e-4), ("c_over_m", 1e-3)):
        quantity = SDOF().quantity(name)
        marginal = estimate.marginal(quantity)
        assert marginal.value == pytest.approx(quantity.value(TRUE), rel=tolerance)
    times = np.linspace(0.0, 8.0, 77)
    exact = simulate(SDOF(), TRUE, InitialState(np.array([0.6]), np.array([-0.8])), times).displacement
    np.testing.assert_allclose(estimate.reconstructions[0](times), exact, atol=1e-4)
    np.testing.assert_allclose(estimate.initial_states[0].velocity, [-0.8], atol=1e-3)


def test_agrees_with_maximum_a_posteriori_by_simulation() -> None:
    """Value and standard deviation of every log-parameter against scipy on the simulated response."""
    sigma = 0.02
    computed = record(sigma, seed=3)
    estimate = PINN().identify(Problem(SDOF(), (computed,), PRIOR), np.random.default_rng(0))

    def rows(z: np.ndarray) -> np.ndarray:
        p = dict(zip(SDOF().names, np.exp(z[:3]), strict=True))
        path = simulate(SDOF(), p, InitialState(z[3:4], z[4:]), computed.channels[0].times).displacement[0]
        return np.concatenate([(path - computed.channels[0].values) / sigma, PRIOR.residuals(z[:3])])

    result = least_squares(rows, np.r_[np.log(list(TRUE.values())), 0.6, -0.8])
    assert estimate.parameters is not None
    distribution = estimate.parameters
    residual = rows(result.x)[:25]
    noise = np.sqrt(residual @ residual / 21)  # sigma is not told: scipy's covariance at the estimated one
    jacobian = result.jac.copy()
    jacobian[:25] /= noise
    sd = np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))[:3]
    assert np.all(np.abs(distribution.mean - result.x[:3]) < 0.1 * sd)
    np.testing.assert_allclose(np.sqrt(np.diag(distribution.covariance)), sd, rtol=0.1)


def test_offset_is_estimated() -> None:
    computed = record(0.005).channels[0]
    shifted = Record((Channel(computed.times, computed.values + 0.4, offset=True),))
    estimate = PINN().identify(Problem(SDOF(), (shifted,)), np.random.default_rng(0))
    assert estimate.offsets[0] == pytest.approx(0.4, abs=0.005)


@pytest.mark.parametrize("method", [PINN(), Collocation()])
def test_reports_of_every_stage_are_estimates(method: PhysicsInformed) -> None:
    """Of a fit that is stopped the last report counts: here all of them are asked for, and the last is the answer's."""
    problem, reports = Problem(SDOF(), (record(0.02, known=True),), PRIOR), list[Estimate]()
    progress.listen(lambda _, estimate: reports.append(estimate()))
    try:
        answer = method.identify(problem, np.random.default_rng(0))
    finally:
        progress.listen(None)
    assert len(reports) > 1
    values = [r.marginal(SDOF().quantity("k_over_m")).value for r in (*reports, answer)]
    np.testing.assert_allclose(values, values[-1], rtol=0.1)
    assert values[-2] == pytest.approx(values[-1], rel=1e-3)


@pytest.mark.slow
def test_papers_training_descends_to_the_same_loss_by_another_road() -> None:
    problem = Problem(SDOF(), (record(0.05, known=True),), PRIOR)
    estimate = PINN(optimizer="adam_lbfgs", adam_steps=50, lbfgs_steps=90).identify(problem, np.random.default_rng(0))
    assert np.all(np.isfinite(estimate.traces["loss"]))
    assert estimate.traces["loss"][-1] < 1e-2 * estimate.traces["loss"][0]
    assert estimate.traces["evaluations"][-1] <= estimate.cost.evaluations


def test_dead_channel_and_absent_device_are_statuses() -> None:
    t = np.linspace(0, 4, 20)
    dead = PINN().identify(Problem(SDOF(), (Record((Channel(t, 0 * t),)),)), np.random.default_rng(0))
    assert dead.status is Status.DIVERGED
    assert "sensor" in dead.message
    if not torch.cuda.is_available():
        absent = PINN(device="cuda").identify(Problem(SDOF(), (record(),)), np.random.default_rng(0))
        assert absent.status is Status.INVALID
        assert "device=cpu" in absent.message


@pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no CUDA device")
@pytest.mark.parametrize("kind", [PINN, Collocation])
def test_a_batch_on_a_gpu_is_the_fits_on_the_processor(kind: type[PhysicsInformed]) -> None:
    problems = [Problem(SDOF(), (record(0.05, known=True, seed=i),), PRIOR) for i in range(4)]
    rngs = [np.random.default_rng(i) for i in range(4)]
    there = kind(device="cuda", batch=4).identify_many(problems, rngs)
    for i, problem in enumerate(problems):
        here = kind().identify(problem, np.random.default_rng(i)).parameters
        sd = np.sqrt(np.diag(here.covariance))
        assert np.all(np.abs(here.mean - there[i].parameters.mean) < 1e-2 * sd)


def test_the_local_functions_of_a_spline_are_those_of_its_full_basis() -> None:
    knots = np.concatenate([np.zeros(5), np.linspace(0.0, 2.0, 12), np.full(5, 2.0)])
    times = np.sort(np.concatenate([np.random.default_rng(0).uniform(0.0, 2.0, 40), np.linspace(0.0, 2.0, 12)]))
    values, first = local_functions(knots, 5, times)
    local = Local(torch.as_tensor(values[None]), torch.as_tensor(first[None]), 16, 1).dense()
    for order in range(3):
        expected = BSpline(knots, np.eye(16), 5)(times, order)
        np.testing.assert_allclose(local.functions[0, order].numpy(), expected, atol=1e-12)


def test_steps_of_a_held_fit_leave_its_parameters() -> None:
    residuals, z, deviations = small(offset=True, n_fits=2)
    covered = residuals.hold()
    state = covered.evaluate(z, deviations)
    torch.testing.assert_close(state.rows, residuals.evaluate(z, deviations).rows)
    walk = levenberg.Walk(z)
    levenberg.minimise(covered, walk, deviations, 5, 1e-9)
    parameters = slice(residuals.n_coefficients, residuals.n_coefficients + len(residuals.free))
    torch.testing.assert_close(walk.z[:, parameters], z[:, parameters], rtol=0.0, atol=0.0)
    assert np.all(residuals.evaluate(walk.z, deviations).loss < 0.5 * state.loss)
