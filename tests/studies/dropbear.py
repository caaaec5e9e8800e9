"""A beam whose support moves while it vibrates: its first frequency, followed sample by sample."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd

from bench import InputError, Layout, Sample, Sensor
from bench.entrants.online import make_online
from bench.reporting.tables.render import markdown_table
from bench.systems import make_system
from tests.studies.common import RESULTS, Out, publish, study

RATE, KEPT_EVERY, HEADER = 5000.0, 20, 9
BAND = (15.0, 70.0)
"""Hz: about the first mode at any position, below the second."""
WARM_UP = 250
REFERENCE = {1.23: 26.9, 1.65: 28.1, 2.09: 30.5, 2.51: 34.2, 2.94: 37.8, 3.37: 41.5}
"""First mode (Hz) by the position sensor's voltage, from a spectrogram (the record's provenance)."""
STILL_V = 0.01
"""The support stands where its sensor moves by less within a tenth of a second."""
Z95 = 1.96
MARGIN = 4.0
"""Hz above and below what is known, of what the picture shows."""


@dataclass(frozen=True, eq=False)
class Record:
    """Times (s), band-passed acceleration (V) and the position sensor (V), all (n,)."""

    times: np.ndarray
    acceleration: np.ndarray
    position: np.ndarray


@dataclass(frozen=True, eq=False)
class Stay:
    """The support at one place: its samples, the reference (Hz), and the peak of the stay's own spectrum."""

    place: float
    samples: np.ndarray
    reference: float
    peak: float


def read(folder: Path) -> Record:
    """Read and filter the record; raises InputError."""
    from scipy.signal import butter, sosfilt

    place = folder / "ten_steps.txt"
    if not place.is_file():
        raise InputError("data", folder, "the folder that holds ten_steps.txt")
    columns = np.loadtxt(place, skiprows=HEADER)
    band = butter(4, BAND, btype="band", fs=RATE, output="sos")
    passed = sosfilt(band, columns[:, 0] - columns[:50, 0].mean())[::KEPT_EVERY]
    return Record(np.arange(passed.size) * KEPT_EVERY / RATE, passed, columns[::KEPT_EVERY, 2])


def followed(record: Record) -> tuple[np.ndarray, np.ndarray]:
    """The natural frequency (Hz) after each sample and the standard deviation of its logarithm; NaN at first."""
    layout = Layout(make_system("sdof", {}), (Sensor("acceleration"),), KEPT_EVERY / RATE, ambient=(0,))
    tracker = make_online("ekf", {"warm_up": WARM_UP}).start(layout)
    found, sds = np.full(record.times.size, np.nan), np.full(record.times.size, np.nan)
    for i, (t, value) in enumerate(zip(record.times.tolist(), record.acceleration.tolist(), strict=True)):
        distribution = tracker.update(Sample(t, (value,))).distribution
        if distribution is not None and distribution.covariance is not None:
            k = distribution.names.index("k")
            found[i], sds[i] = (
                np.exp(0.5 * distribution.mean[k]) / (2 * np.pi),
                0.5 * np.sqrt(distribution.covariance[k, k]),
            )
    return found, sds


def stays(record: Record) -> list[Stay]:
    """Where the support stands at one of the six places for at least 0.4 s."""
    lag = round(0.1 * RATE / KEPT_EVERY)
    moved = np.abs(record.position - np.concatenate([record.position[:lag], record.position[:-lag]]))
    found = []
    for place, reference in REFERENCE.items():
        here = np.flatnonzero((np.abs(record.position - place) < 0.03) & (moved < STILL_V) & (record.times > 1.0))
        for samples in np.split(here, np.flatnonzero(np.diff(here) > lag) + 1):
            samples = np.arange(samples[0], samples[-1] + 1) if samples.size else samples
            if samples.size * KEPT_EVERY / RATE > 0.4:
                found.append(Stay(place, samples, reference, _peak(record.acceleration[samples])))
    return sorted(found, key=lambda stay: stay.samples[0])


def _peak(values: np.ndarray) -> float:
    """Where the spectrum of a stay is largest (Hz), on a grid far finer than its resolution."""
    spectrum = np.abs(np.fft.rfft((values - values.mean()) * np.hanning(values.size), 2**15))
    return float(np.fft.rfftfreq(2**15, KEPT_EVERY / RATE)[np.argmax(spectrum)])


def table(record: Record, found: np.ndarray, sds: np.ndarray) -> str:
    """A row a stay, from half a second into it or its second half."""
    rows = []
    for stay in stays(record):
        late = stay.samples[stay.samples.size // 2 :]
        f, sd = float(np.nanmedian(found[late])), float(np.nanmedian(sds[late]))
        motion = float(np.std(record.acceleration[stay.samples]))
        rows.append([
            f"{record.times[stay.samples[0]]:.2f} to {record.times[stay.samples[-1]]:.2f}", f"{stay.place:.2f}",
            f"{1000 * motion:.0f}", f"{stay.reference:.1f}", f"{stay.peak:.2f}", f"{f:.2f} ± {Z95 * sd * f:.2f}",
            f"{100 * (f / stay.reference - 1):+.1f}", f"{100 * (f / stay.peak - 1):+.1f}",
        ])  # fmt: skip
    headers = ["stay (s)", "position (V)", "motion (mV)", "spectrogram (Hz)", "spectrum of the stay (Hz)",
               "tracker (Hz, 95 %)", "to spectrogram (%)", "to own spectrum (%)"]  # fmt: skip
    return markdown_table(rows, headers)


def draw(record: Record, found: np.ndarray, sds: np.ndarray, folder: Path) -> None:
    """Draw frequency with its band over the reference, and the motion below, with their caption."""
    import altair as alt

    from bench.reporting.pictures.responses import curves, over_time
    from bench.reporting.pictures.style import Picture, layered, save, table

    known = stays(record)
    values = [value for stay in known for value in (stay.reference, stay.peak)]
    low, high = min(values) - MARGIN, max(values) + MARGIN
    bands = {"estimate": found, "low": found * np.exp(-Z95 * sds), "high": found * np.exp(Z95 * sds)}
    tracked = table(curves("", record.times, **{name: np.clip(own, low, high) for name, own in bands.items()}))
    ends = [record.times[stay.samples[[0, -1]]] for stay in known]
    steps = pd.DataFrame(
        [(*end, value, source) for stay, end in zip(known, ends, strict=True)
         for value, source in ((stay.reference, "spectrogram"), (stay.peak, "spectrum of the stay"))],
        columns=["begin", "end", "frequency", "source"],
    )  # fmt: skip
    kind = alt.Color("source:N").scale(range=["#7F7F7F", "#D55E00"]).sort(list(steps.source[:2]))
    rules = (
        alt.Chart(table(steps)).mark_rule(strokeWidth=1.4).encode(alt.X("begin:Q"), kind, x2="end:Q", y="frequency:Q")
    )
    top = layered(tracked, over_time(tracked, "first frequency (Hz)"), rules).resolve_scale(color="independent")
    motion = table(pd.DataFrame({"time": record.times, "volts": 1000 * record.acceleration})[::2])
    volts = alt.Y("volts:Q").axis(tickCount=5).title("acceleration (mV)")
    below = alt.Chart(motion).mark_line(strokeWidth=0.4, style="quiet").encode(alt.X("time:Q").title("time (s)"), volts)
    parts = [part.properties(width=300, height=height) for part, height in ((top, 130), (below, 80))]
    chart = alt.vconcat(*parts).resolve_scale(x="shared")
    save(Picture("online_dropbear", chart, caption(record, found)), folder)


def caption(record: Record, found: np.ndarray) -> str:
    """Return the caption of the picture."""
    known = stays(record)
    off = [abs(float(np.nanmedian(found[stay.samples[stay.samples.size // 2 :]])) / stay.peak - 1.0) for stay in known]
    return (
        f"The tracker follows the moving support to within {100 * max(off):.2g} % where it stands still. Above: first "
        "natural frequency of the beam, followed sample by sample from the acceleration below, the force unknown, and "
        "not told when the support moves. Grey: what a spectrogram says of each stay of the support. Orange: the peak "
        "of the spectrum of that stay alone, which sees all of its samples at once, and from which the error is "
        "measured over the second half of each stay."
    )


HEAD = """# A beam whose support moves

Natural frequency of the first mode, followed sample by sample from the acceleration alone by `ekf`, the force unknown,
beside what a spectrogram with bins of 1.2 Hz says, and the peak of the spectrum of each stay alone. The tracker's value
is the median over the second half of a stay."""


def dropbear(
    data: Annotated[Path, "folder of ten_steps.txt"],
    out: Out = RESULTS,
) -> int:
    """Follow the first frequency of a beam whose support moves: online_dropbear.md and a picture.

    The record (A. Vereen, A. Downey, J. Dodson, A. G. Moura, DROPBEAR, 2023) is not part of this repository.

    The acceleration is band-passed about the first mode by a causal filter, taken down to 250 samples a second, and
    given to the tracker as that of one degree of freedom under an unknown force: the moving support excites the beam.
    The tracker is not told when it moves. The reference frequencies were read off a spectrogram with bins of 1.2 Hz, so
    they are no better than about one percent themselves; so the table also has the peak of the spectrum of each stay
    alone, which sees all of its samples at once.
    """
    record = read(data)
    found, sds = followed(record)
    text = f"{HEAD}\n\n{table(record, found, sds)}\n\nRegenerate: `python -m tests.studies.dropbear data=<folder>`\n"
    publish(out / "online_dropbear.md", text)
    draw(record, found, sds, out / "figures")
    return 0


main = partial(study, dropbear, "tests.studies.dropbear")

if __name__ == "__main__":
    sys.exit(main())
