"""Interface of modal methods, which estimate modes from free decays, hammer blows or frequency responses.

A mode has a natural frequency, a damping ratio and a shape over the channels. The number of modes is estimated unless
it is given.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from bench.contract.estimate import Status
from bench.errors import InputError

Response = Literal["receptance", "mobility", "accelerance"]
"""Displacement, velocity or acceleration per unit of force."""
DERIVATIVES: dict[str, int] = {"receptance": 0, "mobility": 1, "accelerance": 2}
"""Order of the derivative of the displacement."""
MOST_MODES = 10
"""Largest number of modes."""


@dataclass(frozen=True, eq=False)
class FreeDecays:
    """Measured free vibration.

    Attributes:
        times: Times (s), shape (n,).
        values: Values, shape (channels, n); every channel may have an unknown offset.
    """

    times: np.ndarray
    values: np.ndarray


@dataclass(frozen=True, eq=False)
class Blows:
    """Force and response of repeated blows on one point, in records of equal length.

    Attributes:
        step: Sampling interval (s).
        forces: Force (N), shape (records, n).
        responses: Responses, shape (records, outputs, n).
        response: Measured quantity per unit of force.
        window: Decay rate (1/s) of an exponential window already applied to the responses; 0 for none.
    """

    step: float
    forces: np.ndarray
    responses: np.ndarray
    response: Response
    window: float = 0.0


@dataclass(frozen=True, eq=False)
class FrequencyResponses:
    """Frequency response functions for one point of force.

    Attributes:
        frequencies: Frequencies (Hz), shape (lines,).
        values: Complex response per unit of force, shape (outputs, lines).
        response: Measured quantity per unit of force.
        variances: Variance of the complex error, shape (outputs, lines); None if unknown.
        window: Decay rate (1/s) of an exponential window that is not corrected for; 0 for none.
    """

    frequencies: np.ndarray
    values: np.ndarray
    response: Response
    variances: np.ndarray | None = None
    window: float = 0.0


ModalData = FreeDecays | Blows | FrequencyResponses


@dataclass(frozen=True, eq=False)
class ModalProblem:
    """Data and options of a modal analysis.

    Attributes:
        data: Measurements.
        count: Number of modes; None to estimate it.
        band: Lower and upper frequency (Hz) of the analysis; None for all frequencies.

    Raises:
        InputError: If the number of modes is out of range, or the band is empty.
    """

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
    """A mode with standard errors, which are NaN if the method gives none.

    Attributes:
        frequency: Undamped natural frequency (Hz), ``|pole| / 2 pi``.
        damping_ratio: Ratio to critical damping.
        frequency_sd: Standard error of the frequency (Hz).
        damping_ratio_sd: Standard error of the damping ratio.
        shape: Complex shape, shape (channels,). For free decays, the amplitude of ``Re(shape exp(pole (t - t0)))`` at
            the first time t0, in the unit of each channel; for blows and frequency responses, the residue of the
            receptance ``shape / (s - pole)`` plus its conjugate term.
        shape_sd: Standard error of the real part, and of the imaginary part, of the shape, shape (channels,).
        share: Root mean square of the mode relative to that of the data.
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
        """Return the mode of a pole, with standard errors by the delta method.

        Args:
            pole: Pole (1/s) in the upper half plane.
            covariance: Covariance of its real and imaginary parts, shape (2, 2).
            shape: Complex shape, (channels,).
            shape_sd: Standard errors of the shape, (channels,).
            share: Root mean square of the mode relative to that of the data.

        Returns:
            The mode.
        """
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
    """Estimated modes.

    Attributes:
        modes: Modes in order of frequency.
        degrees: Degrees of freedom of Student's t for confidence intervals.
        status: Outcome.
        message: Information for the user, such as how the number of modes was selected.
    """

    modes: tuple[Mode, ...]
    degrees: float = float("inf")
    status: Status = Status.OK
    message: str = ""


@dataclass(frozen=True)
class ModalCard:
    """Description of a modal method for tables.

    Attributes:
        summary: What the method does, in one sentence.
        settings_source: Origin of the default settings.
        title: Name in tables and figures.
        order: Position in tables and figures, lowest first.
    """

    summary: str
    settings_source: str
    title: str
    order: int = 1000


class ModalIdentifier(ABC):
    """Base class of modal methods: a frozen dataclass whose fields are the settings.

    Register a method by an entry point in the group ``bench.modal``. Raise ``version`` when a change of the method
    alters its results.
    """

    version: ClassVar[int] = 1
    card: ClassVar[ModalCard]
    scope: ClassVar[tuple[type, ...]] = (FreeDecays, Blows, FrequencyResponses)
    requires: ClassVar[tuple[str, ...]] = ()
    extra: ClassVar[str] = ""

    @abstractmethod
    def identify_modes(self, problem: ModalProblem) -> ModalEstimate:
        """Estimate the modes; a failure is reported by the status of the estimate, not by an exception."""

    def objection(self, problem: ModalProblem) -> str | None:
        """Return the reason why the method cannot solve the problem, in one sentence; None if it can."""
        if isinstance(problem.data, self.scope):
            return None
        return f"it is made for {' or '.join(WORDS[kind] for kind in self.scope)}, not {WORDS[type(problem.data)]}"


WORDS: dict[type, str] = {
    FreeDecays: "free decays", Blows: "records of force and response", FrequencyResponses: "frequency responses",
}  # fmt: skip
