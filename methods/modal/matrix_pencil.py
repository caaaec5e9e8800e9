"""Matrix pencil method: the free decay of one mass as two damped exponentials.

Samples ``y_j = R₁ z₁^j + R₂ z₂^j`` at even steps h, ``z = e^(sh)``, form a Hankel matrix ``Y[i, j] = y[i + j]`` of
N - L by L + 1, where L is the pencil parameter. Without noise it has rank two. Total least squares keeps the two
singular vectors V of the largest singular values; V without its last and without its first row are V₁ and V₂, and the
poles z are the eigenvalues of ``pinv(V₁) V₂`` (Y. Hua, T. K. Sarkar, IEEE Trans. Acoustics, Speech and Signal
Processing 38:814, 1990; this form: T. K. Sarkar, O. Pereira, IEEE Antennas and Propagation Magazine 37(1):48, 1995;
:mod:`methods.modal.realisation`). With ``s = log(z)/h`` they are the roots of ``s² + (c/m) s + k/m``, so
``k/m = s₁ s₂`` and ``c/m = -(s₁ + s₂)``, for a complex pair and for two real poles. A negative real z is not a pole of
a damped mass; two real decays are then fitted (:mod:`methods.modal.real_decays`).

L is ``pencil`` times the samples. Hua and Sarkar find the smallest variance at N/3 and 2N/3 for one undamped sinusoid,
with little change between; Sarkar and Pereira recommend N/3 to N/2. The default is N/3; other values were not tried.

A sensor's offset is a third exponential, whose known pole 1 is removed. Estimating this pole and separating it from a
slow real one is as good below a damping ratio of 40 % and mostly worse above (18 development systems: damping ratio
2-120 %, 25-80 samples, 10-40 dB).

The covariance is that of the poles to first order (:mod:`methods.modal.perturbation`) where the noise is small, and
otherwise that of a parametric bootstrap.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bench import Card, InputError
from methods.modal.free_decay import Decays, PoleIdentifier
from methods.modal.perturbation import small_noise_covariance
from methods.modal.realisation import MAX_SAMPLES, realise, step_of

NO_VIBRATION = (
    "one of its two poles is negative, which is impossible for a damped mass; "
    "a longer record, more samples during the motion or less noise are required"
)


@dataclass(frozen=True)
class MatrixPencil(PoleIdentifier):
    """Matrix pencil with parameter ``pencil`` times the samples.

    ``bootstrap``: synthetic records for the covariance at large noise; with 0 there is no uncertainty.
    """

    pencil: float = 1.0 / 3.0
    bootstrap: int = 200

    unreadable: ClassVar[str] = NO_VIBRATION
    most_samples: ClassVar[float] = MAX_SAMPLES
    card: ClassVar[Card] = Card(
        summary="two exponentials, a damped vibration or two decays, by the matrix pencil with total least squares",
        start="not used",
        scale="groups",
        reconstruction="simulated",
        uncertainty="covariance of the poles to first order, at large noise of a parametric bootstrap; Student t with "
        "N - 4 degrees of freedom",
        settings_source="pencil parameter N/3: least variance in Hua and Sarkar (1990)",
        tuning="an offset's pole known or estimated: compared on 18 development systems (damping 2-120 %) at 40-10 dB",
        title="Matrix pencil",
        order=100,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.pencil < 1:
            raise InputError(
                "method.pencil", self.pencil, "a fraction of the number of samples, 1/3 to 1/2 recommended"
            )

    def from_poles(self, sets: np.ndarray, step: float, offset: bool) -> np.ndarray:
        return groups_from_poles(poles(sets, self.pencil, offset), step)

    def spread(self, decays: Decays) -> np.ndarray:
        if decays.offset:
            # the first-order formula does not include the offset
            return super().spread(decays)
        length = pencil_length(decays.times.size, self.pencil)
        return small_noise_covariance(decays.groups, decays.centres, decays.noise, step_of(decays.times), length)


def pencil_length(samples: int, pencil: float) -> int:
    """Return the pencil parameter L, limited so that there are at least two rows and columns."""
    return int(np.clip(round(pencil * samples), 2, samples - 2))


def poles(sets: np.ndarray, pencil: float, about_level: bool = False) -> np.ndarray:
    """Estimate two poles z of each data set, complex (sets, 2), from at least four even samples, (sets, n).

    ``about_level`` removes the pole 1 of an unknown constant, which requires one sample more.
    """
    length = pencil_length(sets.shape[-1] - about_level, pencil)
    return realise(sets[:, None], length + 1, 2, about_level)[0]


def groups_from_poles(z: np.ndarray, step: float) -> np.ndarray:
    """Return k/m and c/m, (sets, 2), of two poles z (sets, 2) at a time step.

    NaN where they are neither a complex pair nor both real and positive.
    """
    with np.errstate(all="ignore"):
        s = np.log(z) / step
        groups = np.stack([(s[:, 0] * s[:, 1]).real, -np.sum(s, axis=1).real], axis=1)
    # complex eigenvalues of a real matrix occur in pairs
    real = np.all(np.abs(z.imag) <= 1e-9 * np.abs(z), axis=1)
    return np.where((~real | np.all(z.real > 0, axis=1))[:, None], groups, np.nan)
