"""First-order training: Adam, SOAP and Muon on the gradient of the loss, with a rate that ends at zero.

The loss is divided by the number of its rows, as a mean is what these methods' usual rates are made for.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from methods.pinn_family.loss import Loss

Shapes = Sequence[tuple[int, ...]]
Groups = list[dict[str, Any]]


def descend(
    loss: Loss, z: Tensor, shapes: Shapes, optimizers: Sequence[torch.optim.Optimizer], parts: list[Tensor]
) -> Tensor:
    """Take steps until the work is used up, which ends in :class:`Exhausted`; the rate falls along a half cosine."""
    first = [group["lr"] for optimizer in optimizers for group in optimizer.param_groups]
    while True:
        point = torch.cat([part.reshape(-1) for part in parts]).detach()
        _, gradient = loss.gradient(point)
        gradient = gradient / loss.residuals.n_rows
        for part, own in zip(parts, gradient.split([math.prod(shape) for shape in shapes]), strict=True):
            part.grad = own.reshape(part.shape).clone()
        share = 0.5 * (1.0 + math.cos(math.pi * loss.progress))
        groups = [group for optimizer in optimizers for group in optimizer.param_groups]
        for group, rate in zip(groups, first, strict=True):
            group["lr"] = max(rate * share, 1e-3 * rate)
        for optimizer in optimizers:
            optimizer.step()


def leaves(z: Tensor, shapes: Shapes) -> list[Tensor]:
    """A vector as parameters of their own shapes."""
    sizes = [math.prod(shape) for shape in shapes]
    return [
        part.reshape(shape).clone().requires_grad_(True) for part, shape in zip(z.split(sizes), shapes, strict=True)
    ]


def adam(loss: Loss, z: Tensor, shapes: Shapes, rate: float) -> Tensor:
    """Adam: D. P. Kingma and J. Ba, ICLR 2015."""
    parts = leaves(z, shapes)
    return descend(loss, z, shapes, [torch.optim.Adam(parts, lr=rate)], parts)


def soap(loss: Loss, z: Tensor, shapes: Shapes, rate: float) -> Tensor:
    """SOAP: N. Vyas et al., ICLR 2025; on PINNs S. Wang et al., arXiv:2502.00604."""
    from pytorch_optimizer import SOAP

    parts = leaves(z, shapes)
    return descend(loss, z, shapes, [SOAP(parts, lr=rate, weight_decay=0.0)], parts)


def muon(loss: Loss, z: Tensor, shapes: Shapes, rate: float) -> Tensor:
    """Muon (K. Jordan et al., 2024) for the weights between hidden layers, Adam for all else, as its authors advise."""
    parts = leaves(z, shapes)
    matrices = [part for part in parts if part.ndim == 2 and min(part.shape) > 2]
    others = [part for part in parts if part.ndim != 2 or min(part.shape) <= 2]
    optimizers: list[torch.optim.Optimizer] = [torch.optim.Adam(others, lr=rate)]
    if matrices:
        optimizers.append(torch.optim.Muon(matrices, lr=rate, weight_decay=0.0))
    return descend(loss, z, shapes, optimizers, parts)
