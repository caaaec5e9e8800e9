"""First-order covariance of the poles of the matrix pencil, and its range of validity.

For samples ``y_j = R₁ z₁^j + R₂ z₂^j`` the Hankel matrix is ``Y = Z_l diag(R) Z_rᵀ``, with powers of the poles in Z_l
and Z_r. Let p and q be the rows of ``pinv(Z_l)`` and ``pinv(Z_r)`` for the pole z, with the dimensions of Y without its
last column. A small change δY changes the pole by ``δz = p (δY₂ - z δY₁) qᵀ / R``, where Y₁ and Y₂ are Y without its
last and without its first column (Y. Hua, T. K. Sarkar, IEEE Trans. Acoustics, Speech and Signal Processing 38:814,
1990; the truncation to two singular vectors has no effect to first order). Since Y is constant on antidiagonals,
``dz/dy_t = (c_{t-1} - z c_t) / R`` with the convolution c of p and q. This gives the covariance of ``k/m = |s|²`` and
``c/m = -2 Re s``, ``s = log(z)/h``, at the response of the estimate and the noise about it.

The formula is valid while the two singular values dominate. The largest singular value of the noise is about ``σ``
times the root of the longer side of the Hankel matrix; the criterion is its ratio to the second singular value of the
response. On nine development systems (damping 1-20 %, 2-10 cycles, 25-200 samples, 40 to 5 dB) standard deviations and
coverage are as good as a bootstrap's up to a ratio of 0.2; from there to 0.35 the coverage of 95 % intervals falls to
0.92, where that of the bootstrap is 0.97.
"""

from __future__ import annotations

import numpy as np

SMALL = 0.2
"""Largest ratio of the noise's to the response's second singular value at which the first order is used."""


def small_noise_covariance(
    groups: np.ndarray, centres: np.ndarray, noise: np.ndarray, step: float, length: int
) -> np.ndarray:
    """Compute covariances (sets, 2, 2) of k/m and c/m to first order; NaN where the noise is too large.

    Args:
        groups: k/m and c/m, (sets, 2).
        centres: Fitted free responses, (sets, n).
        noise: Standard deviation of the samples about them, (sets,).
        step: Time step.
        length: Pencil parameter.
    """
    with np.errstate(all="ignore"):
        z, slopes = pole(groups, step), group_slopes(groups, centres, step, length)
        size = noise * np.sqrt(max(centres.shape[1] - length, length + 1))
        small = size < SMALL * second_singular(z, _amplitude(z, centres), centres.shape[1], length)
        covariance = noise[:, None, None] ** 2 * slopes @ slopes.swapaxes(1, 2)
    return np.asarray(np.where(small[:, None, None], covariance, np.nan))


def pole(groups: np.ndarray, step: float) -> np.ndarray:
    """Return the pole z (sets,) above the real axis for k/m and c/m (sets, 2) at a time step."""
    decay = 0.5 * groups[:, 1]
    return np.asarray(np.exp((-decay + 1j * np.sqrt(groups[:, 0] - decay**2)) * step))


def group_slopes(groups: np.ndarray, centres: np.ndarray, step: float, length: int) -> np.ndarray:
    """Differentiate the estimated k/m and c/m by each sample, (sets, 2, n), at the samples ``centres``."""
    z, n = pole(groups, step), centres.shape[1]
    # a product of polynomials with degrees that sum to n - 2
    product = np.fft.ifft(np.fft.fft(_inverse_row(z, n - length), n) * np.fft.fft(_inverse_row(z, length), n))
    shifted = np.concatenate([np.zeros((len(z), 1)), product[:, :-1]], axis=1)
    pole_slopes = (shifted - z[:, None] * product) / _amplitude(z, centres)[:, None]
    rate, s = pole_slopes / (z * step)[:, None], np.log(z)[:, None] / step
    return np.stack([2.0 * (s.conj() * rate).real, -2.0 * rate.real], axis=1)


def second_singular(z: np.ndarray, amplitude: np.ndarray, samples: int, length: int) -> np.ndarray:
    """Compute the second singular value (sets,) of the Hankel matrix of ``2 Re(R z^j)``, with samples - length rows.

    The sum and the product of the squared singular values are trace and determinant of a product of two Gram matrices.
    """
    (a, b), (c, d) = _gram(_powers(z, samples - length)), _gram(_powers(z, length + 1))
    power = np.abs(amplitude) ** 2
    trace = 2.0 * power * a * c + 2.0 * (amplitude**2 * b * d).real
    determinant = power**2 * (a**2 - np.abs(b) ** 2) * (c**2 - np.abs(d) ** 2)
    largest = 0.5 * (trace + np.sqrt(np.maximum(trace**2 - 4.0 * determinant, 0.0)))
    return np.asarray(np.sqrt(determinant / largest))


def _amplitude(z: np.ndarray, centres: np.ndarray) -> np.ndarray:
    return np.asarray(np.sum(_inverse_row(z, centres.shape[1]) * centres, axis=1))


def _powers(z: np.ndarray, count: int) -> np.ndarray:
    """Return powers 0 to count - 1 of z (sets,), (sets, count)."""
    return np.asarray(np.exp(np.log(z)[:, None] * np.arange(count)))


def _gram(powers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return sums of ``|z^j|²`` and of ``z^2j``, each (sets,)."""
    return np.sum(np.abs(powers) ** 2, axis=1), np.sum(powers**2, axis=1)


def _inverse_row(z: np.ndarray, count: int) -> np.ndarray:
    """Return the row for z of the pseudoinverse of the powers of z and of its conjugate, (count, 2)."""
    v = _powers(z, count)
    a, b = _gram(v)
    return np.asarray((a[:, None] * v.conj() - b.conj()[:, None] * v) / (a**2 - np.abs(b) ** 2)[:, None])
