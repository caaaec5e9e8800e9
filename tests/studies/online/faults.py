"""Faults of a stream, and what they leave: the error afterwards over that of the same stream without the fault."""

from __future__ import annotations

import dataclasses
import json
import sys

import numpy as np
from tqdm import tqdm

from bench.config.online import online_scenario
from bench.contract.online import Sample, Standing, Tracker
from bench.entrants.online import make_online, online_card
from bench.online.follow import moments
from bench.online.scenario import Stream
from bench.reporting.tables.common import markdown_table
from bench.twin.state import plain, restored

AT, SAMPLES, BEHIND = 600, 1200, 100
"""The fault's first sample; the record's; samples behind the fault's end from which on errors count."""
METHODS = ("ekf", "imm", "change_points", "cusum", "glr", "rls", "ar", "window_shooting")
FAULTS = {
    "nan": ("5 values missing", 5), "gap": ("20 samples not there", 20), "repeated": ("3 samples twice", 1),
    "saturation": ("a sensor known to end at 80 % of the largest motion", 0),
    "spike": ("3 values 10 sigma off", 40),
    "jump": ("sensor's zero moves by 20 sigma", 0), "crash": ("a step raises an exception", 1),
    "restart": ("saved and restored", 0),
}  # fmt: skip
QUANTITY = "k_over_m"


def faulty(kind: str, stream: Stream) -> list[Sample]:
    """The samples of a stream with a fault."""
    samples, sigma = stream.samples(), float(stream.truth.sigma[0])

    def with_value(i: int, value: float) -> Sample:
        return dataclasses.replace(samples[i], values=(value,))

    if kind == "nan":
        samples[AT : AT + 5] = [with_value(i, float("nan")) for i in range(AT, AT + 5)]
    elif kind == "gap":
        del samples[AT : AT + 20]
    elif kind == "repeated":
        again = [with_value(i, 5.0) for i in range(AT, AT + 3)]
        samples[AT + 3 : AT + 3] = again
    elif kind == "saturation":
        limit = _limit(stream)
        samples = [with_value(i, float(np.clip(sample.values[0], -limit, limit))) for i, sample in enumerate(samples)]
    elif kind == "spike":
        for i in (AT, AT + 20, AT + 40):
            samples[i] = with_value(i, samples[i].values[0] + 10 * sigma)
    elif kind == "jump":
        samples[AT:] = [with_value(i, samples[i].values[0] + 20 * sigma) for i in range(AT, len(samples))]
    return samples


def followed(name: str, kind: str, stream: Stream) -> tuple[np.ndarray, set[str]]:
    """Errors of the logarithm by sample time, (samples,), NaN where there is none; and the statuses that were seen."""
    settings = {"every": 25} if name.startswith("window") else {}
    layout, method = stream.layout, make_online(name, settings)
    if kind == "saturation":
        limits = (-_limit(stream), _limit(stream))
        sensors = tuple(dataclasses.replace(sensor, limits=limits) for sensor in layout.sensors)
        layout = dataclasses.replace(layout, sensors=sensors)
    tracker = method.start(layout)
    place = [quantity.name for quantity in layout.quantities].index(QUANTITY)
    true = np.log(layout.quantities[place].value(stream.truth.parameters))
    errors, seen = np.full(len(true), np.nan), set()
    for sample in faulty(kind, stream):
        i = round(sample.time / layout.interval)
        if kind == "restart" and i == AT:
            tracker = _again(tracker, method.start(layout))
        if kind == "crash" and i == AT:
            standing = _crashing(tracker, sample)
        else:
            standing = tracker.update(sample)
        seen.add(standing.status.value)
        errors[i] = moments(standing, layout)[0][place] - true[i]
    return errors, seen


def _limit(stream: Stream) -> float:
    return 0.8 * float(np.max(np.abs(stream.truth.clean)))


def _again(tracker: Tracker, fresh: Tracker) -> Tracker:
    """What a killed process would go on with: the state through JSON."""
    state = json.loads(json.dumps({name: plain(value) for name, value in tracker.saved().items()}))
    return fresh.restored({name: restored(value) for name, value in state.items()})


def _crashing(tracker: Tracker, sample: Sample) -> Standing:
    own = tracker.step

    def raising(sample: Sample, steps: int) -> None:
        raise ArithmeticError("made to fail")

    tracker.step = raising  # type: ignore[method-assign,assignment]
    try:
        return tracker.update(sample)
    finally:
        tracker.step = own  # type: ignore[method-assign]


def faults(replicates: int) -> str:
    """A row a method, a column a fault."""
    scenario = dataclasses.replace(online_scenario("constant_multisine"), samples=SAMPLES)
    streams = [scenario.stream(2, i) for i in range(replicates)]
    rows = []
    with tqdm(total=len(METHODS) * (1 + len(FAULTS)) * replicates, unit="record", file=sys.stderr) as bar:
        for name in METHODS:
            plainly = [_advanced(bar, followed(name, "none", stream)[0]) for stream in streams]
            row = [online_card(name).title]
            for kind, (_, length) in FAULTS.items():
                late = slice(AT + length + BEHIND, None)
                found = [_advanced(bar, followed(name, kind, stream)[0]) for stream in streams]
                row.append(f"{_rms(found, late) / _rms(plainly, late):.2f}")
            rows.append(row)
    table = markdown_table(rows, ["method", *FAULTS])
    words = "; ".join(f"**{kind}**: {text}" for kind, (text, _) in FAULTS.items())
    return f"{HEAD.format(n=replicates, behind=BEHIND, words=words)}\n\n{table}"


HEAD = """## Faults

Root mean square error of log k/m from {behind} samples behind the fault to the end of the record, over that of the same
{n} records without it. {words}."""


def _advanced(bar: tqdm, errors: np.ndarray) -> np.ndarray:
    bar.update()
    return errors


def _rms(errors: list[np.ndarray], late: slice) -> float:
    own = np.concatenate([one[late] for one in errors])
    return float(np.sqrt(np.nanmean(own**2)))
