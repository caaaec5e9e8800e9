"""What a certificate says, as plain values: the page shows these, and the JSON file holds them."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from bench.likelihood.autoregression import autoregression, even_times
from bench.records.certificate import Certificate
from bench.records.colour import autocorrelation
from bench.records.diagnostics import lag_one, natural_frequency, part_of_signal, whiteness_level
from bench.records.finding import Finding
from bench.records.intervals import StatedInterval
from bench.records.linearised import Linearised
from bench.records.record import summary_of
from bench.records.request import AUTO
from bench.records.verdict import Trust
from bench.records.zeros import unit_over_mass
from bench.reporting.rounding import number, readable, rounded

PACKAGES = ("vibration-bench", "numpy", "scipy", "jax", "casadi", "emcee", "torch")
LAGS = 60
CHI_LOW, CHI_HIGH = -np.log(0.975), -np.log(0.025)
"""A periodogram's ordinate of white noise over its level is exponential: 95 % of them lie between these."""
LAG_BAND = 1.96
OPENING = {
    Trust.TRUST: "These values can be trusted: nothing in the record speaks against them",
    Trust.CAUTION: "Use these values with caution",
    Trust.NO: "Do not trust these values",
}


def contents(certificate: Certificate, command: str) -> dict[str, Any]:
    """All of a certificate; ``command`` makes it again."""
    primary = certificate.primary
    return {
        "verdict": primary.trust.value,
        "method": primary.method,
        "system": equation(primary),
        "sentences": sentences(certificate),
        "reasons": [reason.text for reason in primary.reasons] + unchosen(certificate),
        "record": _record(primary),
        "values": {name: _interval(own) for name, own in primary.intervals.items()},
        "withdrawn": {name: _interval(own) for name, own in primary.withdrawn.items()},
        "residuals": _residuals(primary),
        "prediction": None if certificate.prediction is None else _prediction(certificate),
        "classes": [_class(one, certificate) for one in certificate.classes],
        "compared": list(certificate.names),
        "methods": [_method(one, certificate) for one in certificate.findings],
        "twins": _twins(certificate.twins),
        "what_if": [asdict(one) for one in certificate.what_if],
        "missing": dict(certificate.missing),
        "notes": list(primary.measured.notes),
        "command": command,
        "packages": packages(),
        "series": series(certificate),
    }


def _record(finding: Finding) -> dict[str, Any]:
    """What the records are; ``names`` are those of the files, without their folders."""
    found = summary_of(finding.measured)
    names = [Path(file).name for file in found["files"]]
    return {**found, "names": names, "hashes": [list(pair) for pair in zip(names, found["sha256"], strict=True)]}


def equation(finding: Finding) -> str:
    """The system in words: its terms, or its name."""
    system = finding.problem.system
    terms = getattr(system, "terms", None)
    return " + ".join(terms) if terms else system.name


def sentences(certificate: Certificate) -> list[str]:
    """The verdict, the values and what supports them: three sentences."""
    primary, found = certificate.primary, []
    first = primary.reasons[0].text if primary.reasons else ""
    found.append(f"{OPENING[primary.trust]}{f': {first}' if first else ''}.")
    record = summary_of(primary.measured)
    length = f"{record['samples']} samples over {number(record['seconds'])} s"
    told = [said(name, primary.intervals[name]) for name in certificate.names if name in primary.intervals]
    if told:
        found.append(f"From {length}, {primary.method} finds {' and '.join(told)} (95 %).")
    else:
        found.append(f"From {length}, {primary.method} gives no value that can be stated.")
    return [*found, _support(certificate)]


def _support(certificate: Certificate) -> str:
    """What is left of the signal, and how the other methods stand."""
    primary = certificate.primary
    left = "" if primary.at is None else f"The fit leaves {100 * part_of_signal(primary.at):.2g} % of the signal"
    others = {one.method for one in certificate.findings[1:] if one.intervals}
    off = {one.method for one in certificate.compared if one.standing == "off"}
    if not primary.intervals:
        also = f"{len(others)} of {len(certificate.findings) - 1} other methods state values"
    elif others:
        also = f"{len(others - off)} of {len(others)} other methods agree with it, {len(off)} of them do not"
        also = also if off else f"all {len(others)} other methods that answer agree with it"
    else:
        also = "no other method answers"
    return f"{left}; {also}." if left else f"{also[0].upper()}{also[1:]}."


def unchosen(certificate: Certificate) -> list[str]:
    """That no model was chosen, where one should have been."""
    if certificate.request.system != AUTO or certificate.classes:
        return []
    return [f"no classes of models were compared ({certificate.missing.get('classes', 'none')}): name the system"]


def said(name: str, own: StatedInterval) -> str:
    """``k/m = 52.1 1/s² (51.9 to 52.3)``."""
    value, low, high = rounded(own.value, own.low, own.high)
    unit = "" if own.unit == "-" else f" {own.unit}"
    return f"{readable(name)} = {value}{unit} ({low} to {high})"


def _interval(own: StatedInterval) -> dict[str, Any]:
    return dict(vars(own))


def _residuals(finding: Finding) -> dict[str, Any] | None:
    at = finding.at
    if at is None:
        return None
    channel = finding.problem.records[0].channels[0]
    size = finding.channel_size
    return {
        "rms": float(abs(size) * np.sqrt(np.mean(at.residuals[at.channels[0]] ** 2))),
        "unit": channel.unit,
        "part_of_signal": part_of_signal(at),
        "lag1_autocorrelation": lag_one(at),
        "whiteness": whiteness_level(at),
        "offset": size * float(at.model.offsets(at.theta)[0]),
    }


def _prediction(certificate: Certificate) -> dict[str, Any]:
    assert certificate.prediction is not None
    return {"split": certificate.prediction.split, "fit_pct": certificate.prediction.fit}


def _class(one: Any, certificate: Certificate) -> dict[str, Any]:
    return {
        "name": one.name,
        "criterion_difference": one.criterion,
        "criterion_difference_error": one.criterion_error,
        "told_apart": one.told_apart,
        "residual_pct": 100.0 * one.left,
        "held_out_pct": one.held_out,
        "zero": {name: {"most": most, "unit": unit_over_mass(one.system, name)} for name, most in one.zero.items()},
    }


def _method(one: Finding, certificate: Certificate) -> dict[str, Any]:
    standings = {c.quantity: c.standing for c in certificate.compared if c.method == one.method}
    return {
        "method": one.method,
        "status": one.outcome.status.value,
        "verdict": one.trust.value,
        "message": one.outcome.message,
        "reasons": [reason.text for reason in one.reasons],
        "wall_s": one.outcome.wall_s,
        "values": {name: _interval(own) for name, own in one.intervals.items()},
        "withdrawn": {name: _interval(own) for name, own in one.withdrawn.items()},
        "standing": standings,
    }


def _twins(twins: Any) -> dict[str, Any] | None:
    if twins is None:
        return None
    return {
        "n": twins.n,
        "quantities": list(twins.quantities),
        "lines": [asdict(line) for line in twins.lines],
        "corrected": {name: _interval(own) for name, own in twins.corrected.items()},
    }


def packages() -> dict[str, str]:
    """Versions of what computes, those that are there."""
    found = {"Python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def series(certificate: Certificate) -> dict[str, Any]:
    """The numbers behind the pictures, of the first channel, in its unit; what cannot be told is None."""
    primary = certificate.primary
    channel = primary.problem.records[0].channels[0]
    at, prediction, motion = primary.at, certificate.prediction, certificate.motion
    found: dict[str, Any] = {
        "unit": channel.unit, "measures": channel.measures, "times": channel.times, "values": channel.values,
        "fit": None, "residuals": None, "spectrum": None, "autocorrelation": None, "motion": None, "prediction": None,
    }  # fmt: skip
    if at is None:
        return found
    size, second = primary.channel_size, primary.units.time
    residuals = size * at.residuals[at.channels[0]]
    found |= {"fit": channel.values - residuals, "residuals": residuals}
    if even_times(channel.times) and residuals.size >= 12:
        found["spectrum"] = spectrum(channel.times, residuals, at, size, second)
        found["autocorrelation"] = correlation(residuals)
    if motion is not None:
        found["motion"] = dict(vars(motion))
    if prediction is not None:
        found["prediction"] = {"split": second * prediction.split, "values": size * prediction.predicted}
    return found


def spectrum(times: np.ndarray, residuals: np.ndarray, at: Linearised, size: float, second: float) -> dict[str, Any]:
    """The one-sided power density of residuals: periodogram, autoregression, and the white-noise band.

    ``size`` and ``second``: what natural units are in those of the residuals.
    """
    n, rate = residuals.size, (times.size - 1) / float(np.ptp(times))
    density = 2.0 * np.abs(np.fft.rfft(residuals - np.mean(residuals)))[1:] ** 2 / (n * rate)
    noise = at.noises[0] or autoregression(at.residuals[at.channels[0]])
    level = 2.0 * float(np.var(residuals)) / rate
    own = natural_frequency(at)
    return {
        "frequencies": np.fft.rfftfreq(n, 1.0 / rate)[1:],
        "periodogram": density,
        "autoregression": 2.0 * size**2 * noise.spectrum(n)[1:] / rate,
        "order": noise.order,
        "white_band": [level * float(CHI_LOW), level * float(CHI_HIGH)],
        "natural_frequency": None if own is None else own / second,
    }


def correlation(residuals: np.ndarray) -> dict[str, Any]:
    """The autocorrelation of residuals, with the half-width of the 95 % band of white noise."""
    lags = min(LAGS, residuals.size // 4)
    return {"values": autocorrelation(residuals, lags), "band": LAG_BAND / float(np.sqrt(residuals.size))}


def listed(values: Any) -> Any:
    """The same with lists in place of arrays, for JSON."""
    if isinstance(values, np.ndarray):
        return values.tolist()
    if isinstance(values, np.generic):
        return values.item()
    if isinstance(values, Mapping):
        return {str(key): listed(item) for key, item in values.items()}
    if isinstance(values, Sequence) and not isinstance(values, str):
        return [listed(item) for item in values]
    return values
