"""How far noise moves the poles of the matrix pencil, to first order, and where that is enough.

Of samples ``y_j = R₁ z₁^j + R₂ z₂^j`` the Hankel matrix is ``Y = Z_l diag(R) Z_rᵀ``, Z_l and Z_r holding powers of the
poles. With p the row of ``pinv(Z_l)`` and q that of ``pinv(Z_r)`` that belong to z, both of as many powers as Y without
its last column has rows and columns, a small change δY moves the pole by ``δz = p (δY₂ - z δY₁) qᵀ / R``, Y₁ and Y₂
being Y without its last and without its first column (Y. Hua, T. K. Sarkar, IEEE Trans. Acoustics, Speech and Signal
Processing 38:814, 1990; to first order the truncation to two singular vectors changes nothing). Since sample t stands
on an antidiagonal, ``dz/dy_t = (c_{t-1} - z c_t) / R`` with c the convolution of p and q. By ``s = log(z)/h``,
``k/m = |s|²`` and ``c/m = -2 Re s`` the covariance follows, at the response of the estimate and the noise about it,
from which a parametric bootstrap would draw.

First order holds while the singular vectors that are kept stand out. The largest singular value of the noise is about
``σ`` times the root of the longer side of the Hankel matrix. Its ratio to the second singular value of the response
decides. On nine development systems (damping 1-20 %, 2-10 cycles, 25-200 samples, 40 to 5 dB) the standard deviations
are those of 200 records to 3 % where it is below 0.15, less than the 5 % to which so many tell them, and some 1.3 times
its square too small above. Up to 0.2 logarithmic score, interval score and the cover of 95 % intervals (0.92-0.96 and
0.93-0.97 of 1000 replicates a system) are equal or better. From there to 0.35 the scores stay better, but the cover
falls to 0.92 where that of the bootstrap is 0.97: there records are drawn.
"""

from __future__ import annotations

import numpy as np

SMALL = 0.2
"""Of the second singular value of the response: noise up to which first order does."""


def small_noise_covariance(
    groups: np.ndarray, centres: np.ndarray, noise: np.ndarray, step: float, length: int
) -> np.ndarray:
    """Covariances (sets, 2, 2) of k/m and c/m to first order; NaN where the noise is too large for that.

    Args:
        groups: k/m and c/m, (sets, 2).
        centres: the free responses of these that fit the samples, (sets, n).
        noise: the standard deviation of each sample about them, (sets,).
        step: of time.
        length: the pencil parameter.
    """
    pair = Pair.of(groups, centres, step)
    with np.errstate(all="ignore"):
        slopes = pair.group_slopes(step, length)
        found = noise[:, None, None] ** 2 * slopes @ slopes.swapaxes(1, 2)
        small = noise * np.sqrt(max(centres.shape[1] - length, length + 1)) < SMALL * pair.second_singular(length)
    return np.asarray(np.where(small[:, None, None], found, np.nan))


class Pair:
    """``y_j = 2 Re(R z^j)``: a pole z of each set and its amplitude R, both complex of shape (sets,)."""

    def __init__(self, z: np.ndarray, amplitude: np.ndarray, samples: int) -> None:
        self.z, self.amplitude, self.samples = z, amplitude, samples

    @staticmethod
    def of(groups: np.ndarray, centres: np.ndarray, step: float) -> Pair:
        """The pair of k/m and c/m (sets, 2) at a step of time, with the amplitude of the responses (sets, n)."""
        with np.errstate(all="ignore"):
            decay = 0.5 * groups[:, 1]
            z = np.exp((-decay + 1j * np.sqrt(groups[:, 0] - decay**2)) * step)
            amplitude = np.sum(_inverse_row(z, centres.shape[1]) * centres, axis=1)
        return Pair(z, amplitude, centres.shape[1])

    def pole_slopes(self, length: int) -> np.ndarray:
        """Derivatives of the estimated pole z by each sample, complex (sets, n)."""
        n = self.samples
        rows, columns = _inverse_row(self.z, n - length), _inverse_row(self.z, length)
        # products of polynomials of degrees that add up to n - 2
        both = np.fft.ifft(np.fft.fft(rows, n) * np.fft.fft(columns, n))
        shifted = np.concatenate([np.zeros((len(both), 1)), both[:, :-1]], axis=1)
        return np.asarray((shifted - self.z[:, None] * both) / self.amplitude[:, None])

    def group_slopes(self, step: float, length: int) -> np.ndarray:
        """Derivatives of the estimated k/m and c/m by each sample, (sets, 2, n)."""
        rate = self.pole_slopes(length) / (self.z * step)[:, None]
        s = np.log(self.z)[:, None] / step
        return np.stack([2.0 * (s.conj() * rate).real, -2.0 * rate.real], axis=1)

    def second_singular(self, length: int) -> np.ndarray:
        """The second singular value (sets,) of the Hankel matrix of n - length rows, by the Gram matrices of its sides.

        The squares of both add up to the trace, and multiply to the determinant, of one Gram matrix times the other.
        """
        a, b = _gram(self.z, self.samples - length)
        c, d = _gram(self.z, length + 1)
        power = np.abs(self.amplitude) ** 2
        trace = 2.0 * power * a * c + 2.0 * (self.amplitude**2 * b * d).real
        determinant = power**2 * (a**2 - np.abs(b) ** 2) * (c**2 - np.abs(d) ** 2)
        largest = 0.5 * (trace + np.sqrt(np.maximum(trace**2 - 4.0 * determinant, 0.0)))
        return np.asarray(np.sqrt(determinant / largest))


def _powers(z: np.ndarray, count: int) -> np.ndarray:
    """Powers 0 to count - 1 of z (sets,), shape (sets, count)."""
    return np.asarray(np.exp(np.log(z)[:, None] * np.arange(count)))


def _gram(z: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The powers' ``sum |z^j|²`` and ``sum z^2j``, each (sets,)."""
    v = _powers(z, count)
    return np.sum(np.abs(v) ** 2, axis=1), np.sum(v**2, axis=1)


def _inverse_row(z: np.ndarray, count: int) -> np.ndarray:
    """The row of the pseudoinverse of the powers of z and of its conjugate, (count, 2), that belongs to z."""
    v, (a, b) = _powers(z, count), _gram(z, count)
    return np.asarray((a[:, None] * v.conj() - b.conj()[:, None] * v) / (a**2 - np.abs(b) ** 2)[:, None])
