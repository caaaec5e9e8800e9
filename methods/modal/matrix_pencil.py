"""Matrix pencil: the free decay of one mass as two damped exponentials, without a search.

Samples ``y_j = R₁ z₁^j + R₂ z₂^j`` at even steps h, ``z = e^(sh)``, stand in a Hankel matrix ``Y[i, j] = y[i + j]`` of
N - L by L + 1, where L is the pencil parameter. Without noise its rows span two dimensions. Total least squares: the
two right singular vectors of the largest singular values are kept, which takes the noise out of the shifted and the
unshifted half alike; V without its last and without its first row are the two ends of the pencil, and the poles z are
the eigenvalues of ``pinv(V₁) V₂`` (Y. Hua, T. K. Sarkar, IEEE Trans. Acoustics, Speech and Signal Processing 38:814,
1990; this form: T. K. Sarkar, O. Pereira, IEEE Antennas and Propagation Magazine 37(1):48, 1995). With ``s = log(z)/h``
a complex pair gives ``k/m = |s|²`` and ``c/m = -2 Re s``.

L is ``pencil`` of the samples. Hua and Sarkar find the smallest variance at N/3 and 2N/3 for one undamped sinusoid, and
little change between; Sarkar and Pereira advise N/3 to N/2. Here N/3, and no trial was made of others.

A sensor's offset is a third exponential, of pole 1: three singular vectors are then kept, and of the three poles the
complex pair is the vibration.

The covariance is that of the poles to first order (:mod:`methods.modal.perturbation`) where the noise is small beside
the decay, as told there, else that of a parametric bootstrap.

Even sampling is needed. The start, the prior and the noise level are not used.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bench import Card, Estimate, Identifier, InputError, Problem, Serves
from methods.modal.free_decay import SERVES, Decays, Reading, decay_estimates, decay_objection, has_offset
from methods.modal.perturbation import small_noise_covariance
from methods.modal.subspace import leading_vectors

UNEVEN = 1e-3
"""Steps may differ by this part of themselves: what rounding of printed times does."""
MAX_SAMPLES = 600
"""The decomposition costs the cube of the samples, and the bootstrap repeats it."""
BATCH = 2_000_000
"""Matrix entries decomposed at once."""
NO_VIBRATION = (
    "its two poles are not a complex pair, so the record shows no vibration: "
    "take a longer record, more samples a cycle or less noise"
)


@dataclass(frozen=True)
class MatrixPencil(Identifier):
    """Pencil parameter ``pencil`` times the samples; ``bootstrap`` synthetic records where first order does not do.

    With ``bootstrap=0`` there is no uncertainty.
    """

    pencil: float = 1.0 / 3.0
    bootstrap: int = 200

    card: ClassVar[Card] = Card(
        summary="two damped exponentials by the matrix pencil with total least squares",
        start="not used",
        scale="groups",
        reconstruction="simulated",
        uncertainty="covariance of the poles to first order, at large noise of a parametric bootstrap; Student t with "
        "N - 4 degrees of freedom",
        settings_source="pencil parameter N/3: least variance in Hua and Sarkar (1990)",
        tuning="none",
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
        """Estimate the groups k/m and c/m; ``diverged`` with a sentence where the poles are not a complex pair."""
        return self.estimate_many([problem], [rng])[0]

    def estimate_many(self, problems: Sequence[Problem], rngs: Sequence[np.random.Generator]) -> list[Estimate]:
        """Estimate problems of one layout together."""
        return decay_estimates(problems, rngs, Reading(self._read, NO_VIBRATION, self.bootstrap, self._spread))

    def _read(self, times: np.ndarray, sets: np.ndarray, offset: bool) -> np.ndarray:
        return groups_from_poles(poles(sets, self.pencil, 3 if offset else 2), _step(times))

    def _spread(self, decays: Decays) -> np.ndarray:
        if decays.offset:
            # its pole is known no better than the level is large: nothing of first order
            return np.full((len(decays.groups), 2, 2), np.nan)
        samples = decays.times.size
        return small_noise_covariance(
            decays.groups, decays.centres, decays.noise, _step(decays.times), pencil_length(samples, self.pencil, 2)
        )


def _step(times: np.ndarray) -> float:
    return float(times[-1] - times[0]) / (times.size - 1)


def _sampling_objection(problem: Problem) -> str | None:
    for record in problem.records:
        times = record.channels[0].times
        # amplitude and rate of each exponential, and one sample for the noise
        least = 7 if has_offset(problem) else 5
        if not least <= times.size <= MAX_SAMPLES:
            return f"it takes {least} to {MAX_SAMPLES} samples a record; thin a longer one"
        even = np.linspace(times[0], times[-1], times.size)
        if np.max(np.abs(times - even)) > UNEVEN * (even[1] - even[0]):
            return "it needs samples at even steps of time; resample them"
    return None


def pencil_length(samples: int, pencil: float, count: int) -> int:
    """The pencil parameter L, which leaves as many rows and columns as there are poles."""
    return int(np.clip(round(pencil * samples), count, samples - count))


def poles(sets: np.ndarray, pencil: float, count: int = 2) -> np.ndarray:
    """``count`` poles z of each data set, complex (sets, count), from even samples (sets, n), n >= 2 count."""
    n = sets.shape[-1]
    length = pencil_length(n, pencil, count)
    batch = max(1, BATCH // ((n - length) * (length + 1)))
    found = [_poles(sets[i : i + batch], length, count) for i in range(0, sets.shape[0], batch)]
    return np.concatenate(found)


def _poles(sets: np.ndarray, length: int, count: int) -> np.ndarray:
    hankel = np.lib.stride_tricks.sliding_window_view(sets, length + 1, axis=-1)
    main = leading_vectors(hankel.swapaxes(1, 2), count)
    return np.asarray(np.linalg.eigvals(np.linalg.pinv(main[:, :-1]) @ main[:, 1:])).astype(complex)


def groups_from_poles(z: np.ndarray, step: float) -> np.ndarray:
    """k/m and c/m, (sets, 2), of the complex pair among poles z (sets, 2 or 3) at a step of time; NaN where none is."""
    upper = z[np.arange(z.shape[0]), np.argmax(z.imag, axis=1)]
    with np.errstate(all="ignore"):
        s = np.log(upper) / step
        groups = np.stack([np.abs(s) ** 2, -2.0 * s.real], axis=1)
    pair = upper.imag > 1e-9 * np.abs(upper)
    return np.where(pair[:, None], groups, np.nan)
