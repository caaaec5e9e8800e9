"""Mixture density network from features of a record to a distribution of frequency and decay.

C. M. Bishop, Mixture density networks, Aston University NCRG/94/004, 1994; for the inference of simulator parameters
G. Papamakarios, I. Murray, NeurIPS 2016, arXiv:1605.06376.
"""

from __future__ import annotations

import math
import time

import numpy as np
import torch
from torch import Tensor, nn

from methods.amortised.cache import Arrays
from methods.amortised.simulations import Inputs, SampleLayout, network_inputs, simulated
from methods.sampling.mixture import Mixture

CENTRE, WIDTH = 0.5, 1.5
"""Centre and scale of the log decay rate (times the record) in the network's target."""
LEAST_LOG_SD = -8.0
SMALLEST = 1e-3
"""Added to the standard deviation of a feature, which may be constant."""
POOL = 20_000
"""Number of records simulated at once."""


class Density(nn.Module):
    """A residual network of ``depth`` blocks of ``width`` with a head of ``components`` bivariate normals.

    ``training_seconds``: processor time of the training.
    """

    mean: Tensor
    scale: Tensor
    training_seconds: Tensor

    def __init__(self, inputs: int, width: int, depth: int, components: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(inputs))
        self.register_buffer("scale", torch.ones(inputs))
        self.register_buffer("training_seconds", torch.zeros(()))
        self.first = nn.Linear(inputs, width)
        self.blocks = nn.ModuleList(nn.Linear(width, width) for _ in range(depth))
        self.norms = nn.ModuleList(nn.LayerNorm(width) for _ in range(depth))
        self.head = nn.Linear(width, 6 * components)
        self.components = components

    @staticmethod
    def of(inputs: int, settings: dict[str, int]) -> Density:
        """Return the network for settings ``width``, ``depth`` and ``components``."""
        return Density(inputs, settings["width"], settings["depth"], settings["components"])

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return log-weights (n, K), means (n, K, 2), inverse Cholesky factors (log d1, log d2, below) (n, K, 3)."""
        scaled = (features - self.mean) / self.scale
        h = nn.functional.silu(self.first(scaled))
        for block, norm in zip(self.blocks, self.norms, strict=True):
            h = h + nn.functional.silu(block(norm(h)))
        raw = self.head(h).reshape(len(h), self.components, 6)
        factors = torch.cat([raw[..., 3:5].clamp(-4.0, -LEAST_LOG_SD), raw[..., 5:]], dim=-1)
        return torch.log_softmax(raw[..., 0], dim=-1), raw[..., 1:3], factors

    def loss(self, features: Tensor, target: Tensor) -> Tensor:
        """Return the mean negative log-density of the targets (n, 2)."""
        weights, means, factors = self(features)
        away = target[:, None] - means
        first = torch.exp(factors[..., 0]) * away[..., 0]
        second = torch.exp(factors[..., 1]) * away[..., 1] + factors[..., 2] * first
        logs = weights - 0.5 * (first**2 + second**2) + factors[..., 0] + factors[..., 1] - math.log(2 * math.pi)
        return -torch.logsumexp(logs, dim=-1).mean()


def mixture_of(network: Density, inputs: Inputs) -> Mixture:
    """Return the network's mixture over log frequency and log decay rate for one record."""
    with torch.no_grad():
        weights, means, factors = (part[0].double().numpy() for part in network(torch.as_tensor(inputs.features)))
    inverse = np.zeros((len(weights), 2, 2))
    inverse[:, 0, 0], inverse[:, 1, 1] = np.exp(factors[:, 0]), np.exp(factors[:, 1])
    inverse[:, 1, 0] = factors[:, 2] * inverse[:, 0, 0]
    scale = np.array([float(inputs.step[0]), WIDTH])
    centre = np.array([float(inputs.anchor[0]), CENTRE])
    return Mixture(weights, centre + scale * means, np.linalg.inv(inverse) * scale[:, None])


def trained(layout: SampleLayout, settings: dict[str, int], rate: float) -> Density:
    """Train a network for a layout by Adam with a cosine schedule, on records that are used once.

    Args:
        layout: Times, and whether the initial state is known.
        settings: ``width``, ``depth``, ``components``, ``steps``, ``batch`` and ``seed``.
        rate: Largest learning rate, after a warm-up of 5 % of the steps.
    """
    before, rng = time.process_time(), np.random.default_rng(settings["seed"])
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(settings["seed"])
        features, target = _pool(layout, rng)
        network = Density.of(features.shape[1], settings)
    network.mean.copy_(features.mean(0))
    network.scale.copy_(features.std(0) + SMALLEST)
    optimiser = torch.optim.Adam(network.parameters(), lr=rate)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, rate, total_steps=settings["steps"], pct_start=0.05)
    first = 0
    for _ in range(settings["steps"]):
        if first + settings["batch"] > len(features):
            features, target = _pool(layout, rng)
            first = 0
        part = slice(first, first := first + settings["batch"])
        loss = network.loss(features[part], target[part])
        optimiser.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimiser.step()
        schedule.step()
    network.training_seconds.fill_(time.process_time() - before)
    return network.eval()


def _pool(layout: SampleLayout, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
    """Return features of simulated records, and scaled log frequencies and log decay rates, (n, 2)."""
    logs, values, starts = simulated(layout, POOL, rng)
    inputs = network_inputs(layout, values, starts if layout.known else None)
    frequency, decay = (logs[:, 0] - inputs.anchor) / inputs.step, (logs.sum(axis=1) - CENTRE) / WIDTH
    target = np.stack([frequency, decay], axis=1).astype(np.float32)
    return torch.as_tensor(inputs.features), torch.as_tensor(target)


def from_arrays(arrays: Arrays, settings: dict[str, int]) -> Density:
    """Return the network with stored weights and buffers."""
    network = Density.of(arrays["mean"].shape[0], settings)
    network.load_state_dict({name: torch.as_tensor(value) for name, value in arrays.items()})
    return network.eval()
