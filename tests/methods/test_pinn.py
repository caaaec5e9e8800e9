"""The PINN engine against autograd, explicit Jacobians, scipy's optimisers and exact solutions."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from scipy.optimize import least_squares, minimize

from bench import Channel, Force, InitialState, Prior, Problem, Record, Status, System, Units, simulate
from bench.problem import Measures
from bench.systems import SDOF, Chain, Duffing
from methods.pinn import PINN

torch = pytest.importorskip("torch")

from methods.pinn import levenberg, network  # noqa: E402
from methods.pinn.residuals import Residuals, Spread, State  # noqa: E402
from methods.pinn.spectral import scan  # noqa: E402

TRUE = {"m": 1.7, "c": 0.9, "k": 14.0}
PRIOR = Prior({"m": 1.68, "c": 1.5, "k": 9.0}, {"m": 0.02, "c": 1.0, "k": 0.5})


def layers(widths: tuple[int, ...], seed: int = 0) -> list[tuple[np.ndarray, np.ndarray]]:
    """A network with no zero weight."""
    rng = np.random.default_rng(seed)
    first = network.initial_layers(widths, 3.0, rng)
    return [*first[:-1], (rng.standard_normal(first[-1][0].shape), rng.standard_normal(first[-1][1].shape))]


def record(noise: float = 0.0, known: bool = False, n: int = 25, seed: int = 0) -> Record:
    times = np.linspace(0.0, 8.0, n)
    start = InitialState(np.array([0.6]), np.array([-0.8]))
    clean = simulate(SDOF(), TRUE, start, times).displacement[0]
    values = clean + noise * np.random.default_rng(seed).standard_normal(n)
    return Record((Channel(times, values),), (), start if known else None)


def small(
    system: System | None = None, offset: bool = False, known: bool = True
) -> tuple[Residuals, torch.Tensor, torch.Tensor]:
    """Two records, every kind of channel, a force and a prior, with a small network; and a point and deviations."""
    system = system or SDOF()
    n_dof, rng = system.n_dof, np.random.default_rng(1)
    t = np.linspace(0.0, 1.0, 6)
    start = InitialState(rng.standard_normal(n_dof), rng.standard_normal(n_dof))
    kinds: tuple[Measures, ...] = ("displacement", "velocity", "acceleration")
    channels = tuple(Channel(t, rng.standard_normal(6), kind, n_dof - 1, offset=offset) for kind in kinds)
    force = Force(t, rng.standard_normal(6))
    records = (Record(channels, (force,), start if known else None), Record(channels[:1]))
    names = system.names
    prior = Prior(dict.fromkeys(names, 1.1), dict.fromkeys(names, 0.3))
    widths = (1, 4, 3, 3, n_dof)
    residuals = Residuals(Problem(system, records, prior), widths, 7, names, np.zeros(len(names)), "cpu")
    weights = [network.flat(layers(widths, seed)) for seed in range(2)]
    z = torch.as_tensor(np.concatenate([*weights, 0.3 * rng.standard_normal(residuals.n_unknowns)]))
    return residuals, z, residuals.deviations(Spread((0.1, 0.2, 0.3, 0.4), 5.0, 0.05, 0.5))


@pytest.mark.parametrize("widths", [(1, 6, 2), (1, 6, 5, 1), (1, 4, 7, 3, 2)])
def test_streams_are_autograds_derivatives(widths: tuple[int, ...]) -> None:
    own = [(torch.as_tensor(w), torch.as_tensor(b)) for w, b in layers(widths)]
    times = torch.linspace(0.0, 3.0, 9, dtype=torch.float64, requires_grad=True)
    h = (times / 1.5 - 1.0)[:, None]
    for weight, bias in own[:-1]:
        h = torch.tanh(h @ weight.T + bias)
    x = h @ own[-1][0].T + own[-1][1]
    out = network.forward(own, (times / 1.5 - 1.0).detach(), 1 / 1.5).output
    for j in range(widths[-1]):
        (v,) = torch.autograd.grad(x[:, j].sum(), times, create_graph=True, retain_graph=True)
        (a,) = torch.autograd.grad(v.sum(), times, retain_graph=True)
        for stream, expected in enumerate((x[:, j], v, a)):
            torch.testing.assert_close(out[stream, :, j], expected.detach(), rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize(
    ("system", "offset", "known"), [(SDOF(), True, True), (Duffing(), False, False), (Chain(2), False, True)]
)
def test_jacobian_gradient_and_gram_agree_with_autograd(system: System, offset: bool, known: bool) -> None:
    residuals, z, deviations = small(system, offset, known)
    explicit = _autograd_jacobian(residuals, z, deviations)
    state = residuals.evaluate(z, deviations)
    jacobian = residuals.jacobian(state, deviations)
    scale = float(explicit.abs().max())
    assert float((jacobian - explicit).abs().max()) < 1e-12 * scale
    same, gradient = residuals.gradient(z, deviations)
    torch.testing.assert_close(same.rows, state.rows)
    torch.testing.assert_close(gradient, explicit.T @ state.rows, rtol=1e-11, atol=1e-11 * scale)
    gram = residuals.gram(state, residuals.linearise(state, deviations), 1.0)
    expected = explicit @ explicit.T
    assert float((gram - expected).abs().max()) < 1e-12 * float(expected.abs().max())


def _autograd_jacobian(residuals: Residuals, z: torch.Tensor, deviations: torch.Tensor) -> torch.Tensor:
    """Of the residual vector, written again with torch's own derivatives by time and by z."""
    z = z.clone().requires_grad_(True)
    own_layers, logs, offsets = residuals.split(z)
    outputs = []
    for block, own in zip(residuals.blocks, own_layers, strict=True):
        times = ((block.tau + 1.0) * block.duration / 2.0).requires_grad_(True)
        h = (2.0 * times / block.duration - 1.0)[:, None]
        for weight, bias in own[:-1]:
            h = torch.tanh(h @ weight.T + bias)
        x = h @ own[-1][0].T + own[-1][1]
        streams = [x]
        for _ in range(2):
            slopes = [torch.autograd.grad(c.sum(), times, create_graph=True)[0] for c in streams[-1].unbind(-1)]
            streams.append(torch.stack(slopes, -1))
        outputs.append(torch.stack(streams))
    rows = residuals._rows(outputs, logs, offsets) / deviations
    return torch.stack([torch.autograd.grad(row, z, retain_graph=True)[0] for row in rows])


def test_dual_step_is_the_primal_step() -> None:
    residuals, z, deviations = small()
    state = residuals.evaluate(z, deviations)
    jacobian = residuals.jacobian(state, deviations)
    linear = residuals.linearise(state, deviations)
    gram = residuals.gram(state, linear, 1.0)
    damping = 1e-3 * float(gram.diagonal().max())
    solved = levenberg.step(gram, state.rows, damping)
    assert solved is not None
    dual, promised = solved
    step = -residuals.pull_back(state, linear, dual, 1.0)
    normal = jacobian.T @ jacobian + damping * torch.eye(z.shape[0], dtype=torch.float64)
    primal = -torch.linalg.solve(normal, jacobian.T @ state.rows)
    assert float((step - primal).norm() / primal.norm()) < 1e-10
    left = state.rows + jacobian @ primal
    assert promised == pytest.approx(0.5 * float(state.rows @ state.rows - left @ left), rel=1e-9)


def test_output_only_moves_the_last_layer_and_the_parameters() -> None:
    residuals, z, deviations = small()
    walk = levenberg.Walk(State(z, [], z[:0], {}))
    levenberg.minimise(residuals, walk, deviations, 5, 1e-9, output_only=True)
    moved = (walk.state.z != z).numpy()
    n, last = residuals.n_weights, 3 + 1
    expected = np.concatenate(
        [np.r_[np.zeros(n - last, bool), np.ones(last, bool)]] * 2 + [np.ones(residuals.n_unknowns, bool)]
    )
    np.testing.assert_array_equal(moved, expected)
    assert walk.state.loss < residuals.evaluate(z, deviations).loss


def test_dual_levenberg_goes_lower_than_scipys_lbfgs() -> None:
    problem = Problem(SDOF(), (record(0.05, known=True),), PRIOR)
    scaled = problem.expressed_in(problem.natural_units())
    widths = (1, 12, 12, 1)
    residuals = Residuals(scaled, widths, 60, SDOF().names, np.zeros(3), "cpu")
    weights = network.flat(network.initial_layers(widths, 3.6, np.random.default_rng(0)))
    z = torch.as_tensor(np.r_[weights, 0.0, np.log([6.0, 500.0])])
    deviations = residuals.deviations(Spread((0.1,), 10.0, 0.02, 0.4))

    def loss(at: np.ndarray) -> tuple[float, np.ndarray]:
        state, gradient = residuals.gradient(torch.as_tensor(at), deviations)
        return state.loss, np.asarray(gradient)

    found = minimize(
        loss, z.numpy(), jac=True, method="L-BFGS-B", options={"maxiter": 1000, "maxcor": 30, "ftol": 1e-12}
    )
    walk = levenberg.Walk(State(z, [], z[:0], {}))
    levenberg.minimise(residuals, walk, deviations, 150, 1e-6)
    assert walk.state.loss <= found.fun * (1 + 1e-3)
    assert found.fun < 1e-2 * residuals.evaluate(z, deviations).loss


@pytest.mark.parametrize("known", [True, False])
def test_noise_free_record_gives_the_truth(known: bool) -> None:
    problem = Problem(SDOF(), (record(known=known),), PRIOR)
    estimate = PINN().identify(problem, np.random.default_rng(0))
    assert estimate.status is Status.OK
    for name, tolerance in (("k_over_m", 1e-4), ("c_over_m", 1e-3)):
        quantity = SDOF().quantity(name)
        marginal = estimate.marginal(quantity)
        assert marginal is not None
        assert marginal.value == pytest.approx(quantity.value(TRUE), rel=tolerance)
    times = np.linspace(0.0, 8.0, 77)
    exact = simulate(SDOF(), TRUE, InitialState(np.array([0.6]), np.array([-0.8])), times).displacement
    np.testing.assert_allclose(estimate.reconstructions[0](times), exact, atol=1e-4)
    assert estimate.initial_states is not None
    np.testing.assert_allclose(estimate.initial_states[0].velocity, [-0.8], atol=1e-3)


def test_agrees_with_maximum_a_posteriori_by_simulation() -> None:
    """Value and standard deviation of every log-parameter against scipy on the simulated response."""
    sigma = 0.02
    own = record(sigma, seed=3)
    estimate = PINN().identify(Problem(SDOF(), (own,), PRIOR), np.random.default_rng(0))

    def rows(z: np.ndarray) -> np.ndarray:
        p = dict(zip(SDOF().names, np.exp(z[:3]), strict=True))
        path = simulate(SDOF(), p, InitialState(z[3:4], z[4:]), own.channels[0].times).displacement[0]
        return np.concatenate([(path - own.channels[0].values) / sigma, PRIOR.residuals(z[:3])])

    found = least_squares(rows, np.r_[np.log(list(TRUE.values())), 0.6, -0.8])
    assert estimate.parameters is not None
    belief = estimate.parameters
    residual = rows(found.x)[:25]
    noise = np.sqrt(residual @ residual / 21)  # sigma is not told: scipy's covariance at the estimated one
    jacobian = found.jac.copy()
    jacobian[:25] /= noise
    sd = np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))[:3]
    assert np.all(np.abs(belief.mean - found.x[:3]) < 0.1 * sd)  # type: ignore[union-attr]
    np.testing.assert_allclose(np.sqrt(np.diag(belief.covariance)), sd, rtol=0.1)  # type: ignore[union-attr,arg-type]


def test_units_and_networks_change_nothing() -> None:
    problem = Problem(SDOF(), (record(0.03, known=True),), PRIOR)
    units = Units(3.0, 1e-3, 0.1)
    one = PINN().identify(problem, np.random.default_rng(0)).parameters
    other = (
        PINN().identify(problem.expressed_in(units), np.random.default_rng(0)).expressed_in(units.inverse).parameters
    )
    redrawn = PINN().identify(problem, np.random.default_rng(1)).parameters
    sd = np.sqrt(np.diag(one.covariance))  # type: ignore[union-attr,arg-type]
    assert np.all(np.abs(one.mean - other.mean) < 1e-3 * sd)  # type: ignore[union-attr]
    assert np.all(np.abs(one.mean - redrawn.mean) < 0.05 * sd)  # type: ignore[union-attr]


def test_without_prior_or_force_only_groups_are_told() -> None:
    estimate = PINN().identify(Problem(SDOF(), (record(0.01),)), np.random.default_rng(0))
    assert estimate.parameters is None
    assert estimate.groups is not None
    low, high = estimate.marginal(SDOF().quantity("k_over_m")).interval(0.999)  # type: ignore[union-attr]
    assert low < 14.0 / 1.7 < high
    assert (high - low) < 0.1 * 14.0 / 1.7
    pickle.loads(pickle.dumps(estimate))


def test_offset_is_estimated() -> None:
    own = record(0.005).channels[0]
    shifted = Record((Channel(own.times, own.values + 0.4, offset=True),))
    estimate = PINN().identify(Problem(SDOF(), (shifted,)), np.random.default_rng(0))
    assert estimate.offsets is not None
    assert estimate.offsets[0] == pytest.approx(0.4, abs=0.005)


def test_papers_training_descends_to_the_same_loss_by_another_road() -> None:
    problem = Problem(SDOF(), (record(0.05, known=True),), PRIOR)
    estimate = PINN(optimizer="adam_lbfgs", adam_steps=50, lbfgs_steps=90).identify(problem, np.random.default_rng(0))
    total = sum(estimate.traces[f"loss_{name}"] for name in ("data", "physics", "initial", "prior"))
    assert np.all(np.isfinite(total))
    assert total[-1] < 0.05 * total[0]


def test_scan_finds_the_wave() -> None:
    t = np.sort(np.random.default_rng(0).uniform(0, 6, 30))
    y = np.exp(-0.5 * t) * np.cos(9.0 * t + 1.0)
    guesses, left = scan(Problem(SDOF(), (Record((Channel(t, y),)),)))
    assert guesses[0].omega == pytest.approx(9.0, abs=np.pi / t[-1] / 8 + 1e-9)
    assert left < 0.1


@pytest.mark.parametrize("n", [3, 5])
def test_few_samples_give_a_finite_answer_or_a_sentence(n: int) -> None:
    t = np.linspace(0, 4, n)
    estimate = PINN().identify(
        Problem(SDOF(), (Record((Channel(t, np.cos(2 * t)),)),), PRIOR), np.random.default_rng(0)
    )
    assert estimate.message
    assert estimate.belief is None or estimate.belief.finite()


def test_dead_channel_and_absent_device_are_statuses() -> None:
    t = np.linspace(0, 4, 20)
    dead = PINN().identify(Problem(SDOF(), (Record((Channel(t, 0 * t),)),)), np.random.default_rng(0))
    assert dead.status is Status.DIVERGED
    assert "sensor" in dead.message
    if not torch.cuda.is_available():
        absent = PINN(device="cuda").identify(Problem(SDOF(), (record(),)), np.random.default_rng(0))
        assert absent.status is Status.INVALID
        assert "device=cpu" in absent.message
