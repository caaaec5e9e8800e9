"""Realise a sum of exponentials from its samples: the subspace of a Hankel matrix and its shift.

Samples of n channels at even steps, ``y_j = C A^j s``, are stacked in a block Hankel matrix ``H[i, j] = y_{i+j}``.
Without noise its columns span as many dimensions as there are states. The singular vectors of the largest singular
values are the observability matrix ``[C; CA; CA²; ...]`` in some coordinates, and its shift by one block is A:
eigenvalues z and mode shapes ``C w``. For one channel this is the matrix pencil in the form of total least squares.
"""

from __future__ import annotations

import numpy as np

MAX_SAMPLES = 600
"""The decomposition costs the cube of the samples, and the bootstrap repeats it."""
BATCH = 2_000_000
"""Matrix entries decomposed at once."""
CLEAR = 1e-3
"""Part of the largest singular value; those above it follow from products to 1e-10, at half the cost."""


def step_of(times: np.ndarray) -> float:
    """Return the step of even times (n,)."""
    return float(times[-1] - times[0]) / (times.size - 1)


def realise(sets: np.ndarray, rows: int, states: int, about_level: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Find eigenvalues z (sets, states) and shapes (sets, n, states), complex, of even samples (sets, n, N).

    Args:
        sets: the samples.
        rows: block rows of the Hankel matrix, of which there are N + 1 - ``rows`` columns.
        states: at most as many as there are columns, and rows in all block rows but one.
        about_level: leave out the eigenvalue 1 of an unknown constant. It adds a constant to each row, so that taking
            off the mean of each leaves the span of the columns as it is.
    """
    n, columns = sets.shape[1], sets.shape[2] + 1 - rows
    batch = max(1, BATCH // (n * rows * columns))
    parts = [_realise(sets[i : i + batch], columns, states, about_level) for i in range(0, len(sets), batch)]
    return np.concatenate([z for z, _ in parts]), np.concatenate([shapes for _, shapes in parts])


def _realise(sets: np.ndarray, columns: int, states: int, about_level: bool) -> tuple[np.ndarray, np.ndarray]:
    count, n, _ = sets.shape
    # windows (sets, n, rows, columns) to block rows of n channels each
    hankel = np.lib.stride_tricks.sliding_window_view(sets, columns, axis=-1).swapaxes(1, 2)
    hankel = hankel.reshape(count, -1, columns)
    if about_level:
        hankel = hankel - np.mean(hankel, axis=2, keepdims=True)
    main = leading_vectors(hankel, states)
    z, vectors = np.linalg.eig(np.linalg.pinv(main[:, :-n]) @ main[:, n:])
    return z.astype(complex), (main[:, :n] @ vectors).astype(complex)


def leading_vectors(matrices: np.ndarray, count: int) -> np.ndarray:
    """Find left singular vectors (sets, rows, count) of the largest singular values of matrices (sets, rows, columns).

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
