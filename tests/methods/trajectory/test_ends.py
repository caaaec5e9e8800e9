"""The certificate of a search's end, against a straight line fitted by hand."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from methods.trajectory.ends import ends

TIMES = np.array([0.0, 1.0, 2.0, 3.0])
DATA = np.array([1.0, 1.0, 3.0, 3.0])


def line() -> Any:
    """The model a + b t, as much of it as is asked for."""
    return SimpleNamespace(channel_of=np.zeros(4, int), prior=None)


def test_the_certificate_is_the_cosine_between_jacobian_and_residual() -> None:
    """The line of least squares is 0.8 + 0.8 t; of 1 + 0 t the residuals are 0, 0, -2, -2 and Jᵀ r is (-4, -10)."""
    slopes, sigma = np.stack([np.ones(4), TIMES], 1), np.array([0.5])
    best = ends(cast(Any, line()), np.array([0.8, 0.8]), DATA - 0.8 - 0.8 * TIMES, slopes, sigma, [2.0, 1.0])
    assert best["certificate"][0] < 1e-12
    assert list(best["start_objectives"]) == [1.0, 2.0]
    away = ends(cast(Any, line()), np.array([1.0, 0.0]), DATA - 1.0, slopes, sigma, [1.0])
    assert away["certificate"][0] == pytest.approx(np.sqrt(16.0 + 100.0) / np.sqrt(18.0 * 8.0))
