"""Faults of a stream, and what they leave: the error afterwards over that of the same stream without the fault."""

from __future__ import annotations

import dataclasses
import json

import numpy as np

from bench.config.online import online_scenario
from bench.contract.online import Sample, Tracker, TrackerOutput
from bench.entrants.online import make_online, online_card
from bench.online.follow import moments
from bench.online.scenario import Stream
from bench.reporting.tables.render import markdown_table
from bench.twin.state import plain, restored
from tests.studies.common import tracked

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
WINDOWS_SHARE = 4
"""A window is slow: one record in so many."""


def faulty(kind: str, stream: Stream, at: int = AT) -> list[Sample]:
    """The samples of a stream with a fault from one of them on."""
    samples, sigma = stream.samples(), float(stream.truth.sigma[0])

    def with_value(i: int, value: float) -> Sample:
        return dataclasses.replace(samples[i], values=(value,))

    if kind == "nan":
        samples[at : at + 5] = [with_value(i, float("nan")) for i in range(at, at + 5)]
    elif kind == "gap":
        del samples[at : at + 20]
    elif kind == "repeated":
        again = [with_value(i, 5.0) for i in range(at, at + 3)]
        samples[at + 3 : at + 3] = again
    elif kind == "saturation":
        limit = _limit(stream)
        samples = [with_value(i, float(np.clip(sample.values[0], -limit, limit))) for i, sample in enumerate(samples)]
    elif kind == "spike":
        for i in (at, at + 20, at + 40):
            samples[i] = with_value(i, samples[i].values[0] + 10 * sigma)
    elif kind == "jump":
        samples[at:] = [with_value(i, samples[i].values[0] + 20 * sigma) for i in range(at, len(samples))]
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
    """Return the tracker that a killed process would go on with: its state through JSON."""
    state = json.loads(json.dumps({name: plain(value) for name, value in tracker.saved().items()}))
    return fresh.restored({name: restored(value) for name, value in state.items()})


def _crashing(tracker: Tracker, sample: Sample) -> TrackerOutput:
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
    pairs: dict[tuple[str, str], list[tuple[float, float]]] = {(n, kind): [] for n in METHODS for kind in FAULTS}
    for i in tracked(range(replicates), "record"):  # outermost: filters of one stream share what its first samples told
        stream = scenario.stream(2, i)
        for name in METHODS:
            if i < replicates / WINDOWS_SHARE or not name.startswith("window"):
                plain = followed(name, "none", stream)[0]
                for kind in FAULTS:
                    pairs[name, kind].append(_late_squares(kind, plain, followed(name, kind, stream)[0]))
    rows = [
        [online_card(name).title, f"{len(pairs[name, 'nan'])}", *(_ratio(pairs[name, kind]) for kind in FAULTS)]
        for name in METHODS
    ]
    table = markdown_table(rows, ["method", "records", *FAULTS])
    words = "; ".join(f"**{kind}**: {text}" for kind, (text, _) in FAULTS.items())
    return f"{HEAD.format(behind=BEHIND, words=words)}\n\n{table}"


HEAD = """## Faults

Root mean square error of log k/m from {behind} samples behind the fault to the end of the record, over that of the same
records without it, with its standard error (jackknife). {words}."""


def _late_squares(kind: str, plain: np.ndarray, faulty_one: np.ndarray) -> tuple[float, float]:
    """Mean squared errors behind a fault, without and with it; infinite where an answer is missing."""
    late = slice(AT + FAULTS[kind][1] + BEHIND, None)
    squares = [float(np.mean(errors[late] ** 2)) for errors in (plain, faulty_one)]
    return tuple(square if np.isfinite(square) else float("inf") for square in squares)  # type: ignore[return-value]


def _ratio(pairs: list[tuple[float, float]]) -> str:
    """Root of the ratio of the means, with its standard error; "no answer" where one is missing."""
    a, b = np.array(pairs).T
    if not np.all(np.isfinite([a, b])):
        return "no answer"
    n = a.size
    each = np.sqrt((b.sum() - b) / (a.sum() - a)) if n > 1 else np.full(1, np.nan)
    error = np.sqrt((n - 1) * np.mean((each - each.mean()) ** 2))
    return f"{np.sqrt(b.mean() / a.mean()):.2f} ± {error:.2f}"
