"""The family's functions of time: derivatives against differences, Jacobians against differences of the response."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from methods.pinn_family.architectures import COMPONENTS, FeatureAnsatz, FeatureResponse, Features, Jet  # noqa: E402
from methods.pinn_family.choices import ARCHITECTURES  # noqa: E402

TIMES = np.linspace(0.0, 3.0, 7)


def ansatz(features: Features, times: np.ndarray, n_paths: int = 2) -> tuple[FeatureAnsatz, torch.Tensor]:
    """A function of time of random coefficients at the times, of a record of 3 s."""
    rng = np.random.default_rng(4)
    parts = features.start(2.0, rng)
    body = np.concatenate([part.ravel() + 0.3 * rng.standard_normal(part.size) for part in parts])
    shapes = tuple(part.shape for part in parts)
    tau = torch.as_tensor(2.0 * times / 3.0 - 1.0)[None]
    computed = FeatureAnsatz(features, shapes, tau, torch.full((1,), 2.0 / 3.0, dtype=torch.float64), n_paths)
    head = rng.standard_normal(computed.count - computed.body)
    return computed, torch.as_tensor(np.concatenate([body, head]))[None]


@pytest.mark.parametrize("name", COMPONENTS)
def test_streams_are_the_derivatives_of_the_response(name: str) -> None:
    """Central differences of the function that the answer carries, which is evaluated in another way of calling."""
    features = COMPONENTS[name](16, 2)
    computed, theta = ansatz(features, TIMES)
    streams = computed.forward(theta).output[0].numpy()
    response = FeatureResponse(features, computed.shapes, theta[0].numpy(), 2, 3.0)
    h = 1e-4
    behind, here, ahead = (response(TIMES + side).T for side in (-h, 0.0, h))
    assert streams[0] == pytest.approx(here, rel=1e-10)
    assert streams[1] == pytest.approx((ahead - behind) / (2 * h), rel=1e-4, abs=1e-5)
    assert streams[2] == pytest.approx((ahead - 2 * here + behind) / h**2, rel=1e-3, abs=1e-3)


@pytest.mark.parametrize("name", COMPONENTS)
def test_rows_have_the_jacobian_of_differences(name: str) -> None:
    computed, theta = ansatz(COMPONENTS[name](8, 2), TIMES)
    rng = np.random.default_rng(1)
    points = torch.tensor([0, 3, 3, 6])
    seeds = torch.as_tensor(rng.standard_normal((1, 3, 4, 2)))

    def rows(point: torch.Tensor) -> torch.Tensor:
        return (computed.forward(point).output[:, :, points] * seeds).sum((1, 3))[0]

    tape = computed.forward(theta)
    adjoints = computed.adjoint(theta, tape, seeds, points)
    jacobian = computed.jacobian(tape, adjoints, points)[0]
    for i in rng.choice(computed.count, 12, replace=False):
        step = torch.zeros_like(theta)
        step[0, i] = 1e-6
        wanted = (rows(theta + step) - rows(theta - step)) / 2e-6
        if name in ("fourier", "pirate") and i < computed.sizes[0]:
            wanted = torch.zeros(4)  # their frequencies stay as they are drawn
        assert jacobian[:, i].detach().numpy() == pytest.approx(wanted.numpy(), rel=1e-5, abs=1e-6)
    dual = torch.as_tensor(rng.standard_normal((1, 4)))
    pulled = computed.pull_back(tape, adjoints, points, dual)[0]
    assert pulled.numpy() == pytest.approx((dual[0] @ jacobian).detach().numpy(), rel=1e-9, abs=1e-10)


@pytest.mark.parametrize("name", COMPONENTS)
def test_the_output_layer_alone_gives_the_same_response(name: str) -> None:
    computed, theta = ansatz(COMPONENTS[name](8, 2), TIMES)
    basis, coefficients = computed.head(theta)
    assert basis.forward(coefficients).output.numpy() == pytest.approx(
        computed.forward(theta).output.numpy(), rel=1e-12
    )
    assert torch.equal(computed.with_head(theta, coefficients), theta)


def test_every_other_function_of_time_is_built_from_features() -> None:
    assert set(ARCHITECTURES) == {"tanh", "spline", *COMPONENTS}


def test_a_product_of_jets_follows_the_product_rule() -> None:
    """t² sin t, by hand."""
    t = torch.linspace(0.1, 2.0, 5, dtype=torch.float64)
    time = Jet.of_time(t, torch.ones(1, dtype=torch.float64))
    computed = time * time * time.sin()
    sin, cos = torch.sin(t), torch.cos(t)
    assert torch.allclose(computed.streams[1], 2 * t * sin + t**2 * cos)
    assert torch.allclose(computed.streams[2], 2 * sin + 4 * t * cos - t**2 * sin)
