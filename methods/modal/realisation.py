"""Realisation of a sum of exponentials by the shift invariance of a Hankel matrix's column space.

Samples of n channels at even steps, ``y_j = C A^j s``, form a block Hankel matrix ``H[i, j] = y_{i+j}``, whose rank
without noise is the number of states. The dominant singular vectors are the observability matrix ``[C; CA; CA²; ...]``
in some coordinates, and its shift by one block gives A, with eigenvalues z and mode shapes ``C w``. For one channel
this is the matrix pencil in the form of total least squares.
"""

from __future__ import annotations

import numpy as np

MAX_SAMPLES = 600
"""Largest number of samples; the cost of a decomposition is cubic, and the bootstrap repeats it."""
BATCH = 2_000_000
"""Largest number of matrix entries decomposed at once."""
CLEAR = 1e-3
"""Singular values above this fraction of the largest are computed from the Gram matrix, to 1e-10."""


def step_of(times: np.ndarray) -> float:
    """Return the step of even times (n,)."""
    return float(times[-1] - times[0]) / (times.size - 1)


def realise(sets: np.ndarray, rows: int, states: int, about_level: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Estimate eigenvalues z (sets, states) and shapes (sets, n, states), complex, from even samples.

    Args:
        sets: The samples, (sets, n, N).
        rows: Number of block rows of the Hankel matrix, which has N + 1 - ``rows`` columns.
        states: Number of states, at most that of columns, and of rows in all block rows but one.
        about_level: Remove the eigenvalue 1 of an unknown constant, by subtracting the mean of each row.
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
    """Return the dominant left singular vectors (sets, rows, count) of matrices (sets, rows, columns).

    They are computed as eigenvectors of Gram matrices, or by singular value decomposition where the smallest of these
    singular values is too small for that.
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
