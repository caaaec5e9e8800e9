"""A fit with the training that led to it, and what every way to state its uncertainty shares."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from torch import Tensor

from methods.network.ansatz import Ansatz, Sum
from methods.network.response import Band, Function
from methods.network.tanh import Network
from methods.pinn_family.architectures import FeatureAnsatz
from methods.pinn_family.attempt import FamilyAttempt, TrainedFit
from methods.pinn_family.residuals import TrainingResiduals

CURVES = 50
"""The most responses that are averaged in a reconstruction."""


class Posterior:
    """Minus the log posterior at the end of a training, up to a constant: half the squared residual vector.

    Its deviations are those of ``weighting=noise`` at the noise estimated last, the physics as hard as ``slack`` says,
    whatever the weights that the training had. ``residuals`` is the vector, ``z`` (1, n_z) where the training ended,
    ``n_weights`` the number of coefficients, which stand before the other unknowns.
    """

    def __init__(self, attempt: FamilyAttempt) -> None:
        self.attempt = attempt
        self.residuals = copy.copy(attempt.residuals)
        if isinstance(self.residuals, TrainingResiduals):
            self.residuals.shift = None
        self.deviations = self.residuals.deviations(attempt.spread())
        self.z = attempt.walk.z.clone()
        self.n_weights = self.residuals.n_coefficients

    def parameters(self, z: Tensor) -> np.ndarray:
        """All log-parameters (n_parameters,) at z (1, n_z)."""
        return np.asarray(self.residuals.split(z)[1][0].cpu())

    def offsets(self, z: Tensor) -> np.ndarray:
        """The channels' offsets at z (1, n_z)."""
        return np.asarray(self.residuals.split(z)[2][0].cpu())

    def paths(self, z: Tensor) -> list[np.ndarray]:
        """Displacement at the collocation points, record by record, (n_dof, collocation) each."""
        outputs = self.residuals.evaluate(z, self.deviations).outputs
        blocks = self.residuals.blocks
        return [
            np.asarray(out[0, 0, : block.collocation, : block.n_dof].T.cpu())
            for out, block in zip(outputs, blocks, strict=True)
        ]

    def starts(self, z: Tensor) -> list[np.ndarray]:
        """Displacement and velocity at time 0, record by record, (2, n_dof) each."""
        outputs = self.residuals.evaluate(z, self.deviations).outputs
        return [
            np.asarray(out[0, :2, 0, : block.n_dof].cpu())
            for out, block in zip(outputs, self.residuals.blocks, strict=True)
        ]

    def responses(self, z: Tensor) -> list[Function]:
        """The response by time, record by record."""
        parts, _ = self.residuals.split_flat(z)
        return [self.attempt._response(0, k, np.asarray(part[0].cpu())) for k, part in enumerate(parts)]


@dataclass(frozen=True, eq=False)
class Mean:
    """The mean of responses; can be pickled where they can."""

    responses: tuple[Function, ...]

    def __call__(self, times: np.ndarray) -> np.ndarray:
        """Displacement, shape (n_dof, n_times), at times of shape (n_times,)."""
        return np.asarray(np.mean([own(times) for own in self.responses], axis=0))


@dataclass
class Said:
    """What a way of stating adds to a fit: a remark, arrays worth keeping, gradients taken."""

    remark: str = ""
    traces: Mapping[str, np.ndarray] = field(default_factory=dict)
    gradients: int = 0


def linearised(posterior: Posterior, fit: TrainedFit, covariance: Tensor, bands: Sequence[Tensor]) -> TrainedFit:
    """The fit with another covariance of the unknowns (1, n_unknowns, n_unknowns) and other bands (1, n_dof, m)."""
    n = len(posterior.residuals.free)
    return replace(
        fit,
        covariance=np.asarray(covariance[0, :n, :n].cpu()),
        bands=tuple(Band(old.times, np.asarray(own[0].cpu())) for old, own in zip(fit.bands, bands, strict=True)),
    )


def from_draws(posterior: Posterior, fit: TrainedFit, draws: Sequence[Tensor], said: Said) -> TrainedFit:
    """The fit as draws of z (1, n_z) state it: mean and covariance of the log-parameters, mean response, its spread."""
    logs = np.array([posterior.parameters(z) for z in draws])
    few = [draws[i] for i in np.linspace(0, len(draws) - 1, min(CURVES, len(draws))).astype(int)]
    paths = [posterior.paths(z) for z in draws]
    curves = [posterior.responses(z) for z in few]
    starts = [posterior.starts(z) for z in draws]
    return replace(
        fit,
        logs=logs.mean(0),
        covariance=np.atleast_2d(np.cov(logs[:, posterior.residuals.free].T)),
        responses=tuple(Mean(own) for own in zip(*curves, strict=True)),
        bands=tuple(
            Band(old.times, np.std(own, axis=0, ddof=1))
            for old, own in zip(fit.bands, zip(*paths, strict=True), strict=True)
        ),
        starts=[np.mean(own, axis=0) for own in zip(*starts, strict=True)],
        offsets=np.mean([posterior.offsets(z) for z in draws], axis=0),
        reason=fit.reason + said.remark,
        evaluations=fit.evaluations + said.gradients,
        history={**fit.history, **said.traces},
    )


def hidden_units(ansatz: Ansatz) -> int:
    """How many functions the output layer combines that are no constant and no forced motion."""
    if isinstance(ansatz, Sum):
        return hidden_units(ansatz.inner)
    if isinstance(ansatz, Network):
        return ansatz.widths[-2]
    if isinstance(ansatz, FeatureAnsatz):
        return ansatz.features.n_features()
    return ansatz.count // getattr(ansatz, "n_paths", 1)


def normal(rng: np.random.Generator, shape: tuple[int, ...], like: Tensor) -> Tensor:
    """Standard normal numbers on the device of another tensor."""
    return torch.as_tensor(rng.standard_normal(shape), device=like.device)
