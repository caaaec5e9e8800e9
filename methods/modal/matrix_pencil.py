"""Matrix pencil: the free decay of one mass as two damped exponentials, without a search.

Samples ``y_j = R₁ z₁^j + R₂ z₂^j`` at even steps h, ``z = e^(sh)``, stand in a Hankel matrix ``Y[i, j] = y[i + j]`` of
N - L by L + 1, where L is the pencil parameter. Without noise its rows span two dimensions. Total least squares: the
two right singular vectors of the largest singular values are kept, which takes the noise out of the shifted and the
unshifted half alike; V without its last and without its first row are the two ends of the pencil, and the poles z are
the eigenvalues of ``pinv(V₁) V₂`` (Y. Hua, T. K. Sarkar, IEEE Trans. Acoustics, Speech and Signal Processing 38:814,
1990; this form: T. K. Sarkar, O. Pereira, IEEE Antennas and Propagation Magazine 37(1):48, 1995). With ``s = log(z)/h``
they are the roots of ``s² + (c/m) s + k/m``, so ``k/m = s₁ s₂`` and ``c/m = -(s₁ + s₂)``, be they a complex pair or,
above critical damping, two real ones. A real z below zero belongs to no damped mass: then two real decays may do
(:mod:`methods.modal.overdamped`).

L is ``pencil`` of the samples. Hua and Sarkar find the smallest variance at N/3 and 2N/3 for one undamped sinusoid, and
little change between; Sarkar and Pereira advise N/3 to N/2. Here N/3, and no trial was made of others.

A sensor's offset adds ``b 1 1ᵀ`` to the Hankel matrix: a third exponential, whose pole 1 is known. Each column's mean
is taken off, which leaves out the offset exactly and the span of the rows as it is. Estimating that pole too, and
telling it from a slow real one afterwards, is as good below a damping ratio of 40 % and mostly worse above
(18 development systems: damping ratio 2-120 %, 25-80 samples, 10-40 dB).

The covariance is that of the poles to first order (:mod:`methods.modal.perturbation`) where the noise is small beside
the decay, as told there, else that of a parametric bootstrap.

Even sampling is needed. The start, the prior and the noise level are not used.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bench import Card, Estimate, InputError, Problem, Serves
from methods.modal.even_steps import step_of, unevenness
from methods.modal.free_decay import SERVES, Decays, Reading, decay_estimates, decay_objection, has_offset
from methods.modal.perturbation import small_noise_covariance
from methods.modal.subspace import leading_vectors
from methods.starts.ambiguity import BandIdentifier

MAX_SAMPLES = 600
"""The decomposition costs the cube of the samples, and the bootstrap repeats it."""
BATCH = 2_000_000
"""Matrix entries decomposed at once."""
NO_VIBRATION = (
    "one of its two poles is negative, which no damped mass has: the noise hides it; "
    "take a longer record, more samples where it moves or less noise"
)


@dataclass(frozen=True)
class MatrixPencil(BandIdentifier):
    """Pencil parameter ``pencil`` times the samples; ``bootstrap`` synthetic records where first order does not do.

    With ``bootstrap=0`` there is no uncertainty.
    """

    pencil: float = 1.0 / 3.0
    bootstrap: int = 200

    version: ClassVar[int] = 2
    """2: where noise turns the fast pole of an overdamped decay, two real poles are fitted."""

    card: ClassVar[Card] = Card(
        summary="two exponentials, a damped vibration or two decays, by the matrix pencil with total least squares",
        start="not used",
        scale="groups",
        reconstruction="simulated",
        uncertainty="covariance of the poles to first order, at large noise of a parametric bootstrap; Student t with "
        "N - 4 degrees of freedom",
        settings_source="pencil parameter N/3: least variance in Hua and Sarkar (1990)",
        tuning="an offset's pole known or found: compared on 18 development systems (damping 2-120 %) at 40-10 dB",
        title="Matrix pencil",
        order=100,
        colour="#882255",
        marker="d",
    )
    serves: ClassVar[Serves] = SERVES
    works_in = "natural units"

    def __post_init__(self) -> None:
        if not 0 < self.pencil < 1:
            raise InputError("method.pencil", self.pencil, "a part of the number of samples, N/3 to N/2 say")
        if self.bootstrap < 0:
            raise InputError("method.bootstrap", self.bootstrap, "a number of records, 0 for no uncertainty")

    def objection(self, problem: Problem) -> str | None:
        return super().objection(problem) or decay_objection(problem) or _sampling_objection(problem)

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Estimate the groups k/m and c/m; ``diverged`` with a sentence where a pole is real and negative."""
        return self.estimate_many([problem], [rng])[0]

    def estimate_many(self, problems: Sequence[Problem], rngs: Sequence[np.random.Generator]) -> list[Estimate]:
        """Estimate problems of one layout together."""
        return decay_estimates(problems, rngs, Reading(self._read, NO_VIBRATION, self.bootstrap, self._spread))

    def _read(self, times: np.ndarray, sets: np.ndarray, offset: bool) -> np.ndarray:
        return groups_from_poles(poles(sets, self.pencil, about_level=offset), step_of(times))

    def _spread(self, decays: Decays) -> np.ndarray:
        if decays.offset:
            # its pole is known no better than the level is large: nothing of first order
            return np.full((len(decays.groups), 2, 2), np.nan)
        samples = decays.times.size
        return small_noise_covariance(
            decays.groups, decays.centres, decays.noise, step_of(decays.times), pencil_length(samples, self.pencil, 2)
        )


def _sampling_objection(problem: Problem) -> str | None:
    times = problem.records[0].channels[0].times
    # amplitude and rate of each exponential, and one sample for the noise
    least = 7 if has_offset(problem) else 5
    if not least <= times.size <= MAX_SAMPLES:
        return f"it takes {least} to {MAX_SAMPLES} samples a record; thin a longer one"
    return unevenness(times)


def pencil_length(samples: int, pencil: float, count: int) -> int:
    """The pencil parameter L, which leaves as many rows and columns as there are poles."""
    return int(np.clip(round(pencil * samples), count, samples - count))


def poles(sets: np.ndarray, pencil: float, count: int = 2, about_level: bool = False) -> np.ndarray:
    """``count`` poles z of each data set, complex (sets, count), from even samples (sets, n), n >= 2 count.

    ``about_level`` leaves out the pole 1 of an unknown constant, which needs one row more: n >= 2 count + 1.
    """
    n = sets.shape[-1]
    length = pencil_length(n - about_level, pencil, count)
    batch = max(1, BATCH // ((n - length) * (length + 1)))
    found = [_poles(sets[i : i + batch], length, count, about_level) for i in range(0, sets.shape[0], batch)]
    return np.concatenate(found)


def _poles(sets: np.ndarray, length: int, count: int, about_level: bool) -> np.ndarray:
    hankel = np.lib.stride_tricks.sliding_window_view(sets, length + 1, axis=-1)
    if about_level:
        hankel = hankel - np.mean(hankel, axis=1, keepdims=True)
    main = leading_vectors(hankel.swapaxes(1, 2), count)
    return np.asarray(np.linalg.eigvals(np.linalg.pinv(main[:, :-1]) @ main[:, 1:])).astype(complex)


def groups_from_poles(z: np.ndarray, step: float) -> np.ndarray:
    """k/m and c/m, (sets, 2), of two poles z (sets, 2) at a step of time.

    NaN where they are neither a complex pair nor both real and positive: no mass on a spring moves like that.
    """
    with np.errstate(all="ignore"):
        s = np.log(z) / step
        groups = np.stack([(s[:, 0] * s[:, 1]).real, -np.sum(s, axis=1).real], axis=1)
    # a real matrix has its complex eigenvalues in pairs
    real = np.all(np.abs(z.imag) <= 1e-9 * np.abs(z), axis=1)
    return np.where((~real | np.all(z.real > 0, axis=1))[:, None], groups, np.nan)
