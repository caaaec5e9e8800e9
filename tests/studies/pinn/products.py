"""Time of a fit beside its matrix products alone: the roofline of the engine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.profiler import ProfilerActivity, profile

from tests.studies.engines.floors import least

PRODUCTS = {"aten::mm": 0, "aten::bmm": 0, "aten::addmm": 1, "aten::baddbmm": 1, "aten::baddbmm_": 1}
"""The operations that multiply matrices: which of their inputs is the first factor, the second being the next."""
REPEATS = 5


@dataclass(frozen=True)
class Roofline:
    """Processor seconds of a whole fit, and of its matrix products alone, of the same sizes."""

    whole: float
    products: float

    @property
    def ratio(self) -> float:
        """The whole over its products."""
        return self.whole / self.products


def product_sizes(fit: Callable[[], Any]) -> list[tuple[tuple[int, ...], tuple[int, ...], int]]:
    """The shapes of both factors of each product that the fit computes, and how often."""
    with profile(activities=[ProfilerActivity.CPU], record_shapes=True) as recorded:
        fit()
    found = []
    for event in recorded.key_averages(group_by_input_shape=True):
        if event.key in PRODUCTS:
            first, second = event.input_shapes[PRODUCTS[event.key] :][:2]
            found.append((tuple(first), tuple(second), int(event.count)))
    return found


def roofline(fit: Callable[[], Any]) -> Roofline:
    """Time a fit, and then its products alone on random matrices of double precision."""
    generator = torch.Generator().manual_seed(0)

    def random(shape: tuple[int, ...]) -> Tensor:
        return torch.randn(shape, generator=generator, dtype=torch.float64)

    factors = [(random(first), random(second), count) for first, second, count in product_sizes(fit)]

    def multiply() -> None:
        for first, second, count in factors:
            for _ in range(count):
                torch.matmul(first, second)

    return Roofline(*(least(work, turns=REPEATS, calls=1) for work in (fit, multiply)))
