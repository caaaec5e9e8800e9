"""Contents of a certificate as plain values, for the page and the JSON file."""

from __future__ import annotations

import math
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import periodogram

from bench import __version__
from bench.likelihood.autoregression import autoregression, even_times
from bench.records.certificate import Certificate, agreements, compared_quantities
from bench.records.diagnostics import natural_frequency, part_of_signal
from bench.records.finding import Finding
from bench.records.intervals import StatedInterval
from bench.records.models import ModelClass, unit_over_mass
from bench.records.problem import Measured
from bench.records.response import file_unit, residuals_of
from bench.records.verdict import Trust
from bench.reporting.answer import answer
from bench.reporting.rounding import number

PACKAGES = ("numpy", "scipy", "jax", "casadi", "emcee", "torch")
WHITE_BAND = (-math.log(0.975), -math.log(0.025))
"""Range of 95 % of the ordinates of a periodogram of white noise over its level, which are exponential."""
OPENING = {Trust.TRUST: "Trust: no problems were detected", Trust.CAUTION: "Use with caution", Trust.NO: "Do not trust"}


def contents(certificate: Certificate, command: str) -> dict[str, Any]:
    """Return the contents of a certificate; ``command`` reproduces it."""
    primary, names = certificate.primary, compared_quantities(certificate.findings)
    values, modes, residuals = (
        _intervals(primary.intervals),
        [vars(mode) for mode in primary.modes],
        residuals_of(primary),
    )
    measured = certificate.measured
    record = measured.problem.records[0]
    return {
        "answer": answer(values, modes),
        "verdict": primary.trust.value,
        "method": primary.method,
        "system": " + ".join(getattr(primary.problem.system, "terms", ())) or primary.problem.system.name,
        "sentences": sentences(certificate),
        "reasons": [reason.text for reason in primary.reasons],
        "record": {
            "hashes": [(Path(recording.source).name, recording.sha256) for recording in measured.recordings],
            "samples": measured.problem.n,
            "seconds": record.duration,
            "rate": (record.channels[0].n - 1) / (float(np.ptp(record.channels[0].times)) or 1.0),
            "forced": measured.problem.forced,
        },
        "values": values,
        "withdrawn": _intervals(primary.withdrawn),
        "modes": modes,
        "runs": {
            run.name: {"estimates": _intervals(run.finding.intervals), "left_out": run.left_out} for run in primary.runs
        },
        "residuals": residuals and {key: value for key, value in vars(residuals).items() if key != "values"},
        "prediction": _prediction(certificate),
        "classes": [_class(model, certificate.measured) for model in certificate.classes],
        "compared": names,
        "methods": [_method(finding, primary, names) for finding in certificate.findings],
        "replicas": [asdict(line) for line in certificate.replicas],
        "what_if": [asdict(change) for change in certificate.what_if],
        "missing": certificate.missing,
        "notes": primary.measured.notes,
        "command": command,
        "packages": packages(),
        "series": series(certificate),
    }


def packages() -> dict[str, str]:
    """Return the versions of the packages that computed a certificate, by name."""
    versions = {name: version(name) for name in PACKAGES if find_spec(name)}
    return {"Python": platform.python_version(), "vibration-bench": __version__} | versions


def sentences(certificate: Certificate) -> list[str]:
    """Return the verdict with its first reason, and a sentence on the data, the residuals and other methods."""
    primary, others = certificate.primary, [other for other in certificate.findings[1:] if other.intervals]
    reason = f": {primary.reasons[0].text}" if primary.reasons else ""
    runs = [run for run in primary.runs if not run.left_out]
    problem = certificate.measured.problem
    length = f"{problem.n} samples over {number(problem.records[0].duration)} s"
    support = [f"{primary.method} on " + (f"{len(runs)} runs, each alone" if runs else length)]
    if primary.fit is not None:
        support.append(f"residual RMS: {100 * part_of_signal(primary.fit):.2g} % of signal RMS")
    if primary.intervals:
        names = compared_quantities(certificate.findings)
        agree = sum("off" not in agreements(other, primary, names).values() for other in others)
        support.append(f"{agree} of {len(others)} other methods agree" if others else "no other method")
    return [f"{OPENING[primary.trust]}{reason}.", f"{'; '.join(support)}."]


def _intervals(intervals: Mapping[str, StatedInterval]) -> dict[str, dict[str, Any]]:
    return {name: vars(interval) for name, interval in intervals.items()}


def _prediction(certificate: Certificate) -> dict[str, float] | None:
    """Return how well a fit of the first part of the first channel predicts the rest, or None."""
    prediction, fit = certificate.prediction, certificate.primary.fit
    if prediction is None or fit is None:
        return None
    percent = prediction.fit_percent(fit.model.data, fit.channels[0])
    split = certificate.primary.problem.natural_units().time * prediction.split
    return None if math.isnan(percent) else {"split": split, "fit_pct": percent}


def _class(model: ModelClass, measured: Measured) -> dict[str, Any]:
    zero = {name: {"most": most, "unit": measured.unit_of(unit_over_mass(name))} for name, most in model.zero.items()}
    return {name: value for name, value in vars(model).items() if name != "system"} | {"zero": zero}


def _method(finding: Finding, primary: Finding, names: Sequence[str]) -> dict[str, Any]:
    return {
        "method": finding.method,
        "status": finding.estimate.status.value,
        "verdict": finding.trust.value,
        "message": finding.estimate.message,
        "reasons": [reason.text for reason in finding.reasons],
        "wall_s": finding.wall_s,
        "values": _intervals(finding.intervals),
        "withdrawn": _intervals(finding.withdrawn),
        "agreement": agreements(finding, primary, names),
    }


def series(certificate: Certificate) -> dict[str, Any]:
    """Return the data of the pictures: those of the first channel, in the unit of its file; missing ones are None."""
    primary, residuals = certificate.primary, residuals_of(certificate.primary)
    channel, fit = primary.problem.records[0].channels[0], primary.fit
    unit, size = file_unit(primary.measured)
    series: dict[str, Any] = {
        "source": Path(primary.measured.recordings[0].source).name,
        "unit": unit, "measures": channel.measures, "times": channel.times, "values": channel.values / size,
        "fit": None, "residuals": None, "spectrum": None, "prediction": None,
    }  # fmt: skip
    if fit is None or residuals is None:
        return series
    left, size = residuals.values, primary.channel_size / size
    series |= {"fit": series["values"] - left, "residuals": left}
    if certificate.prediction is not None:
        series["prediction"] = size * certificate.prediction.predicted[fit.channels[0]]
    if not even_times(channel.times) or left.size < 12:
        return series
    rate = (left.size - 1) / float(np.ptp(channel.times))
    noise = fit.noises[0] or autoregression(fit.residuals[fit.channels[0]])
    frequencies, density = periodogram(left, rate)
    level, natural = 2.0 * float(np.var(left)) / rate, natural_frequency(fit)
    series["spectrum"] = {
        "frequencies": frequencies[1:],
        "periodogram": density[1:],
        "autoregression": 2.0 * size**2 * noise.spectrum(left.size)[1:] / rate,
        "order": noise.order,
        "white_band": [level * end for end in WHITE_BAND],
        "natural_frequency": None if natural is None else natural / primary.problem.natural_units().time,
    }
    return series
