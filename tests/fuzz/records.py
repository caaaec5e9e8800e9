"""Hypothesis strategies for records: random bytes, damaged records of every format, and nearly valid texts."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
from hypothesis import strategies as st
from malformed_files import FILES, mat, npy, parquet

from bench.errors import InputError, line_of
from bench.records.reading import ReadOptions, Recording, read_recording

SEEDS = {
    "text": FILES["good.csv"](),
    "gzip": gzip.compress(FILES["good.csv"]()),
    "utf-16": FILES["good.csv"]().decode().encode("utf-16"),
    "npy": npy(np.arange(120.0).reshape(-1, 2)),
    "parquet": parquet({"t": list(range(60)), "x": list(range(60))}),
    "mat": mat(),
}
"""Valid records, which are damaged."""
CELLS = st.one_of(
    st.floats(width=32).map(repr), st.integers(-(10**30), 10**30).map(str), st.text(max_size=6),
    st.sampled_from(["", "nan", "1,5", "1.234,5", '"', "1e999", "−3", "2026-11-25", "#", "t (s)", "x [mm]", "\x00"]),
)  # fmt: skip


@st.composite
def damaged(draw: st.DrawFn) -> bytes:
    """A record with some of its bytes cut out, changed or repeated."""
    data = bytearray(SEEDS[draw(st.sampled_from(sorted(SEEDS)))])
    for _ in range(draw(st.integers(1, 6))):
        at, size = draw(st.integers(0, max(len(data) - 1, 0))), draw(st.integers(0, 40))
        data[at : at + size] = draw(st.one_of(st.binary(max_size=40), st.just(bytes(data[at : at + size]) * 3)))
    return bytes(data)


@st.composite
def written(draw: st.DrawFn) -> bytes:
    """A text of rows, most of them alike."""
    separator, end = draw(st.sampled_from([",", ";", "\t", " ", " ; "])), draw(st.sampled_from(["\n", "\r\n", "\r"]))
    width, n = draw(st.integers(1, 5)), draw(st.integers(0, 30))
    rows = [separator.join(repr(0.1 * (i + 1) * (j + 1)) for j in range(width)) for i in range(n)]
    for _ in range(draw(st.integers(0, 4))):
        odd = separator.join(draw(st.lists(CELLS, min_size=1, max_size=7)))
        rows.insert(draw(st.integers(0, len(rows))), odd)
    encoding = draw(st.sampled_from(["utf-8", "utf-16", "latin-1"]))
    return end.join(rows).encode(encoding, "ignore")


RECORDS = st.one_of(st.binary(max_size=400), damaged(), written())
UNITS = {"t": "s", "x": "m"}
AS_SEEDS = ReadOptions(columns={"t": 0, "x": 1}, units=UNITS)
"""Options with which the seeds are read."""
OPTIONS = st.sampled_from(
    [AS_SEEDS, ReadOptions(), ReadOptions(rate=10.0), ReadOptions(columns={"x": 0}, rate=5.0, units={"x": "mm"})]
)


def check_record(data: bytes, options: ReadOptions, path: Path) -> None:
    """Read a record; whatever it is, there are finite numbers at increasing times, or one line says why there are none.

    ``path`` is where it is written for that.
    """
    path.write_bytes(data)
    try:
        found = read_recording(path, options)
    except InputError as error:
        said = error
    else:
        _check_signals(found)
        return
    assert line_of(said).isprintable()
    assert said.field in {"data", "columns", "units", "rate", "from", "to", "decimate"}
    assert said.remedy


def _check_signals(found: Recording) -> None:
    for signal in found.signals:
        assert np.all(np.isfinite(signal.values))
        assert np.all(np.diff(signal.times) > 0)
        assert signal.values.shape == signal.times.shape
