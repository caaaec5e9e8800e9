"""Prior distribution of the parameters: independent log-normals, the same for every method."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bench.errors import InputError
from bench.systems import Dimension, System


@dataclass(frozen=True)
class Prior:
    """Independent log-normal prior, ``log p ~ Normal(log nominal, log_sd²)``.

    In the benchmark nominal values are drawn around the true values, so that the prior is calibrated but not centred
    on them.

    Attributes:
        nominal: Nominal value of each parameter by name (SI units).
        log_sd: Standard deviation of the logarithm of each parameter, by name.

    Raises:
        InputError: If a value is not a positive number, or the names differ.
    """

    nominal: Mapping[str, float]
    log_sd: Mapping[str, float]

    def __post_init__(self) -> None:
        object.__setattr__(self, "nominal", dict(self.nominal))
        object.__setattr__(self, "log_sd", dict(self.log_sd))
        for name, value in self.nominal.items():
            if not (np.isfinite(value) and value > 0):
                raise InputError(f"prior.nominal.{name}", value, "a nominal value is a positive number")
        for name, value in self.log_sd.items():
            if not (np.isfinite(value) and value > 0):
                raise InputError(f"prior.log_sd.{name}", value, "a standard deviation is a positive number")
        if set(self.nominal) != set(self.log_sd):
            raise InputError("prior.log_sd", sorted(self.log_sd), f"name the parameters {sorted(self.nominal)}")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(self.nominal)

    @property
    def log_mean(self) -> np.ndarray:
        """Mean of the log-parameters, shape (n_parameters,)."""
        return np.asarray(np.log(list(self.nominal.values())))

    @property
    def log_sds(self) -> np.ndarray:
        """Standard deviations of the log-parameters, in the order of ``names``."""
        return np.array([self.log_sd[name] for name in self.nominal])

    def residuals(self, log_parameters: np.ndarray) -> np.ndarray:
        """Return the standardised deviations from the prior mean, shape (..., n_parameters).

        Half the sum of their squares is the negative log density of the prior, up to a constant.
        """
        return np.asarray((log_parameters - self.log_mean) / self.log_sds)

    def expressed_in(self, scale: Mapping[str, float]) -> Prior:
        """Return the prior of the parameters divided by their scales."""
        return Prior({n: value / scale[n] for n, value in self.nominal.items()}, self.log_sd)


def draw_prior(
    system: System,
    truth: Mapping[str, float],
    sd_by_kind: Mapping[str, float],
    rng: np.random.Generator,
    wrong: bool = False,
) -> Prior:
    """Draw a prior with nominal values around the true values ``truth``.

    Args:
        system: System whose parameters are drawn in order.
        truth: True values by name.
        sd_by_kind: Standard deviation of the logarithm, by kind of parameter.
        rng: Random generator.
        wrong: True for a miscalibrated prior: every nominal value is three standard deviations off, in a random
            direction.

    Returns:
        The prior.
    """
    sds = {p.name: float(sd_by_kind[p.kind]) for p in system.parameters}

    def deviation() -> float:
        return 3.0 * float(rng.choice([-1.0, 1.0])) if wrong else rng.standard_normal()

    return Prior({n: truth[n] * float(np.exp(sds[n] * deviation())) for n in system.names}, sds)


def dimension_scale(dimension: Dimension, mass: float, length: float, time: float) -> float:
    """Return the size of the unit of a dimension.

    Args:
        dimension: Exponents of mass, length and time.
        mass: Size of the unit of mass.
        length: Size of the unit of length.
        time: Size of the unit of time.

    Returns:
        Product of powers of the base units.
    """
    return float(mass**dimension.mass * length**dimension.length * time**dimension.time)
