"""The dimensions that Hankel matrices span: singular vectors of the largest singular values, of many at once."""

from __future__ import annotations

import numpy as np

CLEAR = 1e-3
"""Of the largest singular value. One above this part of it is found from products to 1e-10, at half the cost."""


def leading_vectors(matrices: np.ndarray, count: int) -> np.ndarray:
    """Left singular vectors (sets, rows, count) of the largest singular values of matrices (sets, rows, columns).

    They are eigenvectors of the matrices' products with their transposes, which square the singular values; where the
    smallest of those that are wanted is not clear, the matrix itself is decomposed.
    """
    wide = matrices.shape[1] <= matrices.shape[2]
    transposed = matrices.swapaxes(1, 2)
    squares, vectors = np.linalg.eigh(matrices @ transposed if wide else transposed @ matrices)
    squares, vectors = squares[:, ::-1], vectors[..., ::-1][..., :count]
    clear = squares[:, count - 1] > CLEAR**2 * squares[:, 0]
    if not wide:
        vectors = matrices @ vectors / np.sqrt(np.where(clear[:, None], squares[:, :count], 1.0))[:, None]
    if not np.all(clear):
        vectors[~clear] = np.linalg.svd(matrices[~clear], full_matrices=False)[0][..., :count]
    return np.asarray(vectors)
