"""Contents of a certificate of several modes as plain values, for the page and the JSON file."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from bench.contract.modal import Blows, FreeDecays, FrequencyResponses
from bench.records.certificate import agreement_of
from bench.records.intervals import StatedInterval
from bench.records.modal import ModalFinding, ShapedMode, modal_response
from bench.records.verdict import Trust
from bench.reporting.answer import answer
from bench.reporting.certificate.contents import OPENING, packages
from bench.reporting.certificate.pictures import spectra_of_modes

MOST_COMPARED = 4
"""Number of modes, the strongest, whose frequencies are compared between methods."""
UNCHECKED = "replicas have one mode; Table 12 gives the coverage of intervals of several modes on simulated records"


def modal_contents(findings: Sequence[ModalFinding], files: Sequence[Path], command: str) -> dict[str, Any]:
    """Return all of a certificate of modes; the first of ``findings`` is the primary method's."""
    primary, modes = findings[0], [asdict(mode) for mode in findings[0].modes]
    record, response = primary.record, modal_response(primary)
    residuals = None if response is None or response.fit is None else vars(response.fit.residuals)
    compared = _compared(primary)
    methods = [_method(finding, primary, compared) for finding in findings]
    return {
        "answer": answer({}, modes),
        "verdict": primary.trust.value,
        "method": primary.method,
        "system": "sum of modes",
        "sentences": _sentences(primary, residuals, methods[1:]),
        "reasons": [reason.text for reason in primary.reasons],
        "record": {
            "hashes": [(path.name, hashlib.sha256(path.read_bytes()).hexdigest()) for path in files],
            "samples": record.samples,
            **_extent(primary),
            "forced": not isinstance(record.data, FreeDecays),
        },
        "values": {}, "withdrawn": {}, "modes": modes, "runs": {},
        "residuals": residuals and {key: value for key, value in residuals.items() if key != "values"},
        "prediction": None, "classes": [],
        "compared": list(compared),
        "methods": methods,
        "replicas": [], "what_if": [],
        "missing": {"replicas": UNCHECKED},
        "notes": primary.notes,
        "command": command,
        "packages": packages(),
        "series": _series(primary, record.source),
    }  # fmt: skip


def _extent(primary: ModalFinding) -> dict[str, float]:
    """Return length (s) and sampling rate (Hz); of frequency responses 0 for both."""
    data = primary.record.data
    if isinstance(data, FrequencyResponses):
        return {"seconds": 0.0, "rate": 0.0}
    step = data.step if isinstance(data, Blows) else float(np.ptp(data.times)) / (data.times.size - 1)
    return {"seconds": step * (primary.record.samples - 1), "rate": 1.0 / step}


def _compared(primary: ModalFinding) -> dict[str, ShapedMode]:
    """Return the strongest modes of the primary method by name, in order of frequency."""
    strongest = sorted(primary.modes, key=lambda mode: -mode.share)[:MOST_COMPARED]
    return {f"mode {i}": mode for i, mode in enumerate(sorted(strongest, key=lambda mode: mode.frequency), 1)}


def _method(finding: ModalFinding, primary: ModalFinding, compared: dict[str, ShapedMode]) -> dict[str, Any]:
    """Return a method's frequencies nearest to those compared, and whether they agree."""
    values, agreement = {}, {}
    for name, mode in compared.items() if finding.trust is not Trust.NO else ():
        nearest = min(finding.modes, key=lambda other: abs(other.frequency - mode.frequency))
        values[name] = _interval(nearest)
        reference = _interval(mode) if primary.trust is not Trust.NO else None
        agreement[name] = "primary" if finding is primary else agreement_of(values[name], reference)
        if agreement[name] == "off" and math.isnan(values[name].low):
            agreement[name] = "-"  # without an interval its accuracy is unknown
    return {
        "method": finding.method, "status": finding.estimate.status.value, "verdict": finding.trust.value,
        "message": finding.estimate.message, "reasons": [reason.text for reason in finding.reasons],
        "wall_s": finding.wall_s, "values": {name: vars(value) for name, value in values.items()}, "withdrawn": {},
        "agreement": agreement, "modes": [asdict(mode) for mode in finding.modes],
    }  # fmt: skip


def _interval(mode: ShapedMode) -> StatedInterval:
    ends = (mode.frequency_low, mode.frequency_high)
    return StatedInterval(mode.frequency, *ends, *ends, *ends, "Hz")


def _sentences(primary: ModalFinding, residuals: dict[str, Any] | None, others: Sequence[dict[str, Any]]) -> list[str]:
    reason = f": {primary.reasons[0].text}" if primary.reasons else ""
    sensors = len(primary.record.channels)
    each = f" of each of {sensors} sensors" if sensors > 1 else ""
    support = [f"{primary.method} on {primary.record.samples} samples{each}"]
    if residuals:
        support.append(f"residual RMS: {100 * residuals['part_of_signal']:.2g} % of signal RMS")
    stating = [method for method in others if {*method["agreement"].values()} - {"-"}]
    if primary.trust is not Trust.NO:
        agree = sum("off" not in method["agreement"].values() for method in stating)
        support.append(f"{agree} of {len(stating)} other methods agree" if stating else "no other method")
    return [f"{OPENING[primary.trust]}{reason}.", f"{'; '.join(support)}."]


def _series(primary: ModalFinding, source: str) -> dict[str, Any]:
    """Return the data of the pictures: free motion of the first channel, and spectra of the channel that moves most."""
    response, spectra = modal_response(primary), spectra_of_modes(primary)
    series = {"source": Path(source).name, "modes": spectra, "spectrum": None, "prediction": None}
    if response is None:
        return series
    left = None if response.fit is None else response.fit.residuals.values
    return series | {
        "unit": response.unit, "measures": response.measures, "times": response.times, "values": response.values,
        "fit": None if left is None else response.values - left, "residuals": left,
    }  # fmt: skip
