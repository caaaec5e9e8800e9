"""The contract of a modal method: free decays, blows or frequency responses in; modes with their uncertainty out.

A mode is a natural frequency, a damping ratio and what it does in each channel. How many there are is part of the
answer unless it is told.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from bench.contract.estimate import Status
from bench.errors import InputError

Response = Literal["receptance", "mobility", "accelerance"]
"""What is measured per unit of force: displacement, velocity or acceleration."""
DERIVATIVES: dict[str, int] = {"receptance": 0, "mobility": 1, "accelerance": 2}
"""How often the displacement is differentiated."""
MOST_MODES = 10


@dataclass(frozen=True, eq=False)
class FreeDecays:
    """Free vibration: ``times`` (n,) in s; ``values`` (channels, n), each about a constant of its own."""

    times: np.ndarray
    values: np.ndarray


@dataclass(frozen=True, eq=False)
class Blows:
    """Force and response at one point of force, records of equal length.

    ``step`` in s; ``forces`` (records, n) in N; ``responses`` (records, outputs, n); ``window``: decay rate (1/s) of an
    exponential window that the responses were multiplied with already, 0 without.
    """

    step: float
    forces: np.ndarray
    responses: np.ndarray
    response: Response
    window: float = 0.0


@dataclass(frozen=True, eq=False)
class FrequencyResponses:
    """Response per unit of force: ``frequencies`` (lines,) in Hz; ``values`` (outputs, lines), complex.

    ``variances`` (outputs, lines): mean square of the complex error, None where it is not known; ``window``: decay rate
    (1/s) of an exponential window that is still in them, 0 without.
    """

    frequencies: np.ndarray
    values: np.ndarray
    response: Response
    variances: np.ndarray | None = None
    window: float = 0.0


ModalData = FreeDecays | Blows | FrequencyResponses


@dataclass(frozen=True, eq=False)
class ModalProblem:
    """What a modal method is given: ``count`` modes, or as many as the data show; in ``band`` (Hz), or in all of it."""

    data: ModalData
    count: int | None = None
    band: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if self.count is not None and not 1 <= self.count <= MOST_MODES:
            raise InputError("modes", self.count, f"auto, or a number from 1 to {MOST_MODES}")
        if self.band is not None and not 0.0 <= self.band[0] < self.band[1]:
            raise InputError("band", f"{self.band[0]:g}:{self.band[1]:g}", "lower:upper in Hz, as 10:40")


@dataclass(frozen=True, eq=False)
class Mode:
    """A mode with standard errors, NaN where the method gives none.

    ``frequency``: the natural frequency (Hz), that of the undamped mode, ``|pole| / 2 pi``; ``damping_ratio``: of
    critical damping; ``shape`` (channels,), complex: of free decays the amplitude of ``Re(shape exp(pole (t - t0)))``
    at the first time t0, in each channel's unit; of blows and frequency responses the residue of the receptance,
    ``shape / (s - pole)`` beside its conjugate; ``shape_sd`` (channels,): standard error of its real part, and of its
    imaginary part. ``share``: part of the root mean square of the data that is this mode's.
    """

    frequency: float
    damping_ratio: float
    frequency_sd: float
    damping_ratio_sd: float
    shape: np.ndarray
    shape_sd: np.ndarray
    share: float = float("nan")

    @staticmethod
    def of_pole(
        pole: complex, covariance: np.ndarray, shape: np.ndarray, shape_sd: np.ndarray, share: float = float("nan")
    ) -> Mode:
        """Return the mode of a pole (1/s) whose real and imaginary parts have this covariance, shape (2, 2)."""
        real, imaginary, rate = float(pole.real), float(pole.imag), float(abs(pole))
        by = np.array([[real / rate, imaginary / rate], [-(imaginary**2) / rate**3, real * imaginary / rate**3]])
        rate_sd, ratio_sd = (float(sd) for sd in np.sqrt(np.diag(by @ covariance @ by.T)))
        return Mode(rate / (2 * np.pi), -real / rate, rate_sd / (2 * np.pi), ratio_sd, shape, shape_sd, share)

    @property
    def pole(self) -> complex:
        """Pole (1/s) in the upper half plane."""
        rate = 2.0 * np.pi * self.frequency
        return complex(-self.damping_ratio * rate, rate * np.sqrt(max(1.0 - self.damping_ratio**2, 0.0)))

    @property
    def bandwidth(self) -> float:
        """Half-power bandwidth (Hz)."""
        return 2.0 * self.damping_ratio * self.frequency


@dataclass(frozen=True, eq=False)
class ModalEstimate:
    """Modes in order of frequency.

    ``degrees``: degrees of freedom of Student's t, by which standard errors become intervals; ``message``: what a user
    should know; how the number of modes was decided.
    """

    modes: tuple[Mode, ...]
    degrees: float = float("inf")
    status: Status = Status.OK
    message: str = ""


@dataclass(frozen=True)
class ModalCard:
    """What a table says of a modal method."""

    summary: str
    settings_source: str
    title: str
    order: int = 1000


class ModalIdentifier(ABC):
    """A modal method: a frozen dataclass whose fields are its settings.

    Register it by an entry point in the group ``bench.modal``. Raise ``version`` where a change of the method alters
    its results.
    """

    version: ClassVar[int] = 1
    card: ClassVar[ModalCard]
    scope: ClassVar[tuple[type, ...]] = (FreeDecays, Blows, FrequencyResponses)
    requires: ClassVar[tuple[str, ...]] = ()
    extra: ClassVar[str] = ""

    @abstractmethod
    def identify_modes(self, problem: ModalProblem) -> ModalEstimate:
        """Find the modes; a failure is an estimate with its status, not an exception."""

    def objection(self, problem: ModalProblem) -> str | None:
        """Say why this method cannot serve the problem, in a sentence; None where it can."""
        if isinstance(problem.data, self.scope):
            return None
        return f"it is made for {' or '.join(WORDS[kind] for kind in self.scope)}, not {WORDS[type(problem.data)]}"


WORDS: dict[type, str] = {
    FreeDecays: "free decays", Blows: "records of force and response", FrequencyResponses: "frequency responses",
}  # fmt: skip
