"""PySINDy with its default settings: its finite differences and its sparse regression.

The documentation of the package suggests for a measured displacement ``x``::

    v = pysindy.FiniteDifference()(x, times)
    model = pysindy.SINDy(feature_names=["x", "v"]).fit(np.column_stack([x, v]), t=times)

with the defaults of the package: central differences, monomials of the state up to degree two, and sequentially
thresholded least squares that drops coefficients below 0.1 (Brunton, Proctor and Kutz, PNAS 113 (2016) 3932-3937). This
threshold depends on units: in those used here the record lasts 1 and the displacement is of size 1, and terms are
rarely dropped; in SI units the errors on the reference system are the same to 1 %. k/m and c/m are the negative
coefficients of ``x`` and ``v`` in the second equation, whatever other terms it has; a known force is the control input,
whose coefficient is 1/m. The method ``sindy`` adds a spline, a choice of terms by simulation and a projection onto the
equation of motion.

The displacement is differentiated twice by central differences, so even without noise k/m is estimated as
``(sin(ωh)/(ωh))²`` times its value at a sampling step ``h``: 38 % low at the 5.3 samples per cycle of the paper's
Table 3.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from bench import SDOF, Card, Estimate, Identifier, NoEstimate, Normal, Problem, Scope, Status


@dataclass(frozen=True)
class PlainPySINDy(Identifier):
    """PySINDy's defaults with its finite differences; no settings and no uncertainty."""

    card: ClassVar[Card] = Card(
        summary="PySINDy's defaults with its finite differences: no smoothing, no knowledge of the equation of motion",
        start="not used",
        scale="groups",
        reconstruction="simulated",
        uncertainty="none: the package gives none",
        settings_source="defaults of pysindy 2.1: second-order differences, degree 2, STLSQ above 0.1",
        title="pysindy as it ships",
        order=152,
        states_terms=True,
    )
    scope: ClassVar[Scope] = Scope(nonlinear=False)
    requires: ClassVar[tuple[str, ...]] = ("pysindy",)
    extra: ClassVar[str] = "sindy"
    works_in = "natural units"

    def objection(self, problem: Problem) -> str | None:
        other = None if isinstance(problem.system, SDOF) else "it supports one mass, spring and damper only"
        return super().objection(problem) or other

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        (record,) = problem.records
        times, x = record.channels[0].times, record.channels[0].values
        if times.size < 3:
            raise NoEstimate("finite differences require at least 3 samples", Status.UNSUPPORTED)
        force = np.array(record.force(times, 1))[0] if record.forces else None
        terms = _model(times, x, force)
        groups = np.array([-terms["x"], -terms["v"]])
        if not np.all(np.isfinite(groups)):
            raise NoEstimate("the regression gave no finite coefficients", Status.DIVERGED)
        kept = ", ".join(name for name, value in terms.items() if value) or "none"
        message, system = f"terms kept of {len(terms)}: {kept}", problem.system
        if not problem.scale_known:
            return Estimate(system, groups=Normal(("k_over_m", "c_over_m"), groups, None, log=False), message=message)
        inverse_mass = terms.get("f", 0.0)
        values = np.array([1.0, *groups[::-1]]) / inverse_mass if inverse_mass else np.zeros(3)
        if np.any(values <= 0):
            raise NoEstimate("a parameter is not positive, or the force was dropped from the model", Status.DIVERGED)
        return Estimate(system, Normal(("m", "c", "k"), np.log(values), None, log=True), message=message)


def _model(times: np.ndarray, x: np.ndarray, force: np.ndarray | None) -> dict[str, float]:
    """Fit pysindy's model and return the coefficients of the acceleration by term."""
    import pysindy

    inputs: dict[str, Any] = {} if force is None else {"u": force[:, None]}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        velocity = pysindy.FiniteDifference()(x[:, None], times)
        model = pysindy.SINDy()
        model.fit(np.hstack([x[:, None], velocity]), times, feature_names=["x", "v", *("f" for _ in inputs)], **inputs)
    return dict(zip(model.get_feature_names(), model.coefficients()[1].tolist(), strict=True))
