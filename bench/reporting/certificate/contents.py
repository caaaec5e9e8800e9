"""What a certificate states, as plain values: the page shows these, and the JSON file holds them."""

from __future__ import annotations

import math
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from bench.likelihood.autoregression import autoregression, even_times
from bench.records.certificate import Certificate, agreements, compared_quantities
from bench.records.colour import autocorrelation
from bench.records.diagnostics import lag_one, natural_frequency, part_of_signal, whiteness_level
from bench.records.finding import Finding
from bench.records.intervals import StatedInterval
from bench.records.linearised import Linearised
from bench.records.models import ModelClass, unit_over_mass
from bench.records.problem import summary_of
from bench.records.verdict import Trust
from bench.reporting.answer import answer
from bench.reporting.rounding import number

PACKAGES = ("vibration-bench", "numpy", "scipy", "jax", "casadi", "emcee", "torch")
LAGS = 60
CHI_LOW, CHI_HIGH = -np.log(0.975), -np.log(0.025)
"""A periodogram's ordinate of white noise over its level is exponential: 95 % of them lie between these."""
LAG_BAND = 1.96
OPENING = {
    Trust.TRUST: "Trust: no problems were detected",
    Trust.CAUTION: "Use with caution",
    Trust.NO: "Do not trust",
}


def contents(certificate: Certificate, command: str) -> dict[str, Any]:
    """Return all of a certificate; ``command`` reproduces it."""
    primary = certificate.primary
    record = summary_of(certificate.measured)
    files = [Path(file).name for file in record["files"]]
    modes = [dict(vars(mode)) for mode in primary.modes]
    names = compared_quantities(certificate.findings)
    record |= {"names": files, "hashes": [list(pair) for pair in zip(files, record["sha256"], strict=True)]}
    values = _intervals(primary.intervals)
    return {
        "answer": answer(values, modes),
        "verdict": primary.trust.value,
        "method": primary.method,
        "system": " + ".join(getattr(primary.problem.system, "terms", ())) or primary.problem.system.name,
        "sentences": sentences(certificate),
        "reasons": [reason.text for reason in primary.reasons],
        "record": record,
        "values": values,
        "withdrawn": _intervals(primary.withdrawn),
        "modes": modes,
        "runs": {
            run.name: {"estimates": _intervals(run.finding.intervals), "left_out": run.left_out} for run in primary.runs
        },
        "residuals": _residuals(primary),
        "prediction": _prediction(certificate),
        "classes": [_class(one) for one in certificate.classes],
        "compared": names,
        "methods": [_method(finding, primary, names) for finding in certificate.findings],
        "replicas": [asdict(line) for line in certificate.replicas],
        "what_if": [asdict(one) for one in certificate.what_if],
        "missing": dict(certificate.missing),
        "notes": list(primary.measured.notes),
        "command": command,
        "packages": packages(),
        "series": series(certificate),
    }


def sentences(certificate: Certificate) -> list[str]:
    """Return the verdict with its first reason, and what supports the answer."""
    primary = certificate.primary
    reason = f": {primary.reasons[0].text}" if primary.reasons else ""
    record = summary_of(certificate.measured)
    length = f"{record['samples']} samples over {number(record['seconds'])} s"
    runs = [run.name for run in primary.runs if not run.left_out]
    support = [f"{primary.method} on " + (f"{len(runs)} runs, each alone" if runs else length)]
    if primary.fit is not None:
        support.append(f"residual RMS: {100 * part_of_signal(primary.fit):.2g} % of signal RMS")
    others = {one.method for one in certificate.findings[1:] if one.intervals}
    names = compared_quantities(certificate.findings)
    off = {one.method for one in certificate.findings if "off" in agreements(one, primary, names).values()}
    if primary.intervals:
        support.append(f"{len(others - off)} of {len(others)} other methods agree" if others else "no other method")
    return [f"{OPENING[primary.trust]}{reason}.", f"{'; '.join(support)}."]


def _intervals(intervals: Mapping[str, StatedInterval]) -> dict[str, dict[str, Any]]:
    return {name: dict(vars(interval)) for name, interval in intervals.items()}


def _residuals(finding: Finding) -> dict[str, Any] | None:
    at = finding.fit
    if at is None:
        return None
    size = finding.channel_size
    return {
        "rms": float(abs(size) * np.sqrt(np.mean(at.residuals[at.channels[0]] ** 2))),
        "unit": finding.problem.records[0].channels[0].unit,
        "part_of_signal": part_of_signal(at),
        "lag1_autocorrelation": lag_one(at),
        "whiteness": whiteness_level(at),
        "offset": size * float(at.model.offsets(at.theta)[0]),
    }


def _prediction(certificate: Certificate) -> dict[str, float] | None:
    """Return what a fit of the first part of the first channel predicts of the rest; None where it predicts nothing."""
    prediction, at = certificate.prediction, certificate.primary.fit
    if prediction is None or at is None:
        return None
    fit = prediction.fit_percent(at.model.data, at.channels[0])
    if math.isnan(fit):
        return None
    return {"split": certificate.primary.problem.natural_units().time * prediction.split, "fit_pct": fit}


def _class(one: ModelClass) -> dict[str, Any]:
    return {
        "name": one.name,
        "criterion_difference": one.criterion,
        "criterion_difference_error": one.criterion_error,
        "told_apart": one.told_apart,
        "residual_pct": 100.0 * one.left,
        "held_out_pct": one.held_out,
        "zero": {name: {"most": most, "unit": unit_over_mass(one.system, name)} for name, most in one.zero.items()},
    }


def _method(one: Finding, primary: Finding, names: Sequence[str]) -> dict[str, Any]:
    return {
        "method": one.method,
        "status": one.estimate.status.value,
        "verdict": one.trust.value,
        "message": one.estimate.message,
        "reasons": [reason.text for reason in one.reasons],
        "wall_s": one.wall_s,
        "values": _intervals(one.intervals),
        "withdrawn": _intervals(one.withdrawn),
        "agreement": agreements(one, primary, names),
    }


def packages() -> dict[str, str]:
    """Return the versions of what computes, of those that are installed."""
    versions = {"Python": platform.python_version()}
    for name in PACKAGES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            continue
    return versions


def series(certificate: Certificate) -> dict[str, Any]:
    """Return the numbers behind the pictures, of the first channel, in its unit; None where there are none."""
    primary, prediction = certificate.primary, certificate.prediction
    channel, at = primary.problem.records[0].channels[0], primary.fit
    series: dict[str, Any] = {
        "source": Path(primary.measured.recordings[0].source).name,
        "unit": channel.unit, "measures": channel.measures, "times": channel.times, "values": channel.values,
        "fit": None, "residuals": None, "spectrum": None, "autocorrelation": None, "prediction": None,
    }  # fmt: skip
    if at is None:
        return series
    size, second = primary.channel_size, primary.problem.natural_units().time
    residuals = size * at.residuals[at.channels[0]]
    series |= {"fit": channel.values - residuals, "residuals": residuals}
    if even_times(channel.times) and residuals.size >= 12:
        lags = min(LAGS, residuals.size // 4)
        band = LAG_BAND / float(np.sqrt(residuals.size))
        series["spectrum"] = spectrum(channel.times, residuals, at, size, second)
        series["autocorrelation"] = {"values": autocorrelation(residuals, lags), "band": band}
    if prediction is not None:
        series["prediction"] = size * prediction.predicted[at.channels[0]]
    return series


def spectrum(times: np.ndarray, residuals: np.ndarray, at: Linearised, size: float, second: float) -> dict[str, Any]:
    """Return the one-sided power density of residuals: periodogram, autoregression, and the white-noise band.

    ``size`` and ``second``: natural units in those of the residuals.
    """
    n, rate = residuals.size, (times.size - 1) / float(np.ptp(times))
    density = 2.0 * np.abs(np.fft.rfft(residuals - np.mean(residuals)))[1:] ** 2 / (n * rate)
    noise = at.noises[0] or autoregression(at.residuals[at.channels[0]])
    level = 2.0 * float(np.var(residuals)) / rate
    frequency = natural_frequency(at)
    return {
        "frequencies": np.fft.rfftfreq(n, 1.0 / rate)[1:],
        "periodogram": density,
        "autoregression": 2.0 * size**2 * noise.spectrum(n)[1:] / rate,
        "order": noise.order,
        "white_band": [level * float(CHI_LOW), level * float(CHI_HIGH)],
        "natural_frequency": None if frequency is None else frequency / second,
    }


def listed(values: Any) -> Any:
    """Return the same with lists in place of arrays, for JSON."""
    if isinstance(values, np.ndarray | np.generic):
        return values.tolist()
    if isinstance(values, Mapping):
        return {str(key): listed(item) for key, item in values.items()}
    if isinstance(values, Sequence) and not isinstance(values, str):
        return [listed(item) for item in values]
    return values
