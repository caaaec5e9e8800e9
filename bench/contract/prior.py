"""The nominal prior: independent log-normals on the parameters, the same for every method."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bench.errors import InputError
from bench.systems import Dimension, System


@dataclass(frozen=True)
class Prior:
    """``log p ~ Normal(log nominal, log_sd²)``, independently for each parameter.

    ``nominal`` holds what is stated of each parameter (SI units), ``log_sd`` the standard deviation of its
    logarithm. The nominal values are drawn around the truth, so a prior is calibrated and never centred on it.
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
        """Standardised distance from the prior, shape (..., n_parameters); half its square is the penalty."""
        return np.asarray((log_parameters - self.log_mean) / self.log_sds)

    def expressed_in(self, scale: Mapping[str, float]) -> Prior:
        """The same prior with each parameter divided by its scale."""
        return Prior({n: value / scale[n] for n, value in self.nominal.items()}, self.log_sd)


def draw_prior(
    system: System, truth: Mapping[str, float], sd_by_kind: Mapping[str, float], rng: np.random.Generator
) -> Prior:
    """A calibrated prior: nominal values drawn around the truth with the stated width of each kind."""
    sds = {p.name: float(sd_by_kind[p.kind]) for p in system.parameters}
    return Prior({n: truth[n] * float(np.exp(sds[n] * rng.standard_normal())) for n in system.names}, sds)


def wrong_prior(
    system: System, truth: Mapping[str, float], sd_by_kind: Mapping[str, float], rng: np.random.Generator
) -> Prior:
    """A miscalibrated prior: every nominal value three standard deviations off, to a random side."""
    sds = {p.name: float(sd_by_kind[p.kind]) for p in system.parameters}
    return Prior({n: truth[n] * float(np.exp(3.0 * sds[n] * rng.choice([-1.0, 1.0]))) for n in system.names}, sds)


def dimension_scale(dimension: Dimension, mass: float, length: float, time: float) -> float:
    """Size in SI of one unit of the given dimension, when mass, length and time have these units."""
    return float(mass**dimension.mass * length**dimension.length * time**dimension.time)
