"""The leading singular vectors against numpy's decomposition, of matrices of all shapes and conditions."""

from __future__ import annotations

import numpy as np
import pytest

from methods.modal.realisation import leading_vectors


def matrices(rows: int, columns: int, smallest: float) -> np.ndarray:
    """Three sets of rank two with noise of 1e-3 of the smaller singular value, which is ``smallest`` of the larger."""
    draw = np.random.default_rng(2)
    left = np.linalg.qr(draw.standard_normal((3, rows, 2)))[0] * np.array([1.0, smallest])
    right = np.linalg.qr(draw.standard_normal((3, columns, 2)))[0]
    noise = 1e-3 * smallest * draw.standard_normal((3, rows, columns))
    return np.asarray(left @ right.swapaxes(1, 2) + noise)


@pytest.mark.parametrize("shape", [(6, 9), (9, 6), (7, 7)])
@pytest.mark.parametrize("smallest", [0.5, 2e-3, 1e-5])
def test_they_span_what_those_of_the_decomposition_do(shape: tuple[int, int], smallest: float) -> None:
    """Projectors on the two spans are alike to 1e-8, though products would lose a value of 1e-5 among the rounding."""
    given = matrices(*shape, smallest)
    expected = np.linalg.svd(given)[0][..., :2]
    computed = leading_vectors(given, 2)
    np.testing.assert_allclose(computed.swapaxes(1, 2) @ computed, np.broadcast_to(np.eye(2), (3, 2, 2)), atol=1e-9)
    np.testing.assert_allclose(computed @ computed.swapaxes(1, 2), expected @ expected.swapaxes(1, 2), atol=1e-8)


def test_sets_of_different_conditions_do_not_mix() -> None:
    given = np.concatenate([matrices(9, 6, 0.5), matrices(9, 6, 1e-6)])
    for first, two in zip(given, leading_vectors(given, 2), strict=True):
        np.testing.assert_allclose(two, leading_vectors(first[None], 2)[0], atol=1e-12)
