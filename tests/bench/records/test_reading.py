"""Reading of measured records: unusual files are read correctly, or rejected in one line that says what to add."""

from __future__ import annotations

import gzip
import hashlib
import io
import math
import sys
import tracemalloc
import zipfile
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io

from bench.errors import InputError
from bench.records.reading import ReadOptions, Recording, files, of_arrays, read_recording, read_recordings
from bench.records.reading.headings import column_of
from bench.records.reading.times import rebuilt as clock_of
from bench.records.reading.units import unit_of

DEGREE = math.pi / 180
T = [0.0, 0.5, 1.0, 2.5]
X = [1.0, -2.25, 3.5, 0.125]
GRID = np.arange(200) / 100
"""Times at 100 Hz."""


def read(path: Path, **options: Any) -> Recording:
    return read_recording(path, ReadOptions(**options))


def write(folder: Path, content: str | bytes, encoding: str = "utf-8", name: str = "record.csv") -> Path:
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode(encoding))
    return path


def rows(separator: str = ",", decimal: str = ".", times: list[float] = T, values: list[float] = X) -> str:
    lines = [f"{t!r}{separator}{x!r}" for t, x in zip(times, values, strict=True)]
    return "\n".join(line.replace(".", decimal) for line in lines) + "\n"


def rebuilt(stamps: np.ndarray, unit: float) -> tuple[np.ndarray, list[str]]:
    clock = clock_of(stamps, unit)
    return clock.times, list(clock.notes)


def in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Read files in the process of the test, which is faster than a separate one."""
    monkeypatch.setattr(files, "_table_of_child", lambda path: files._table(path.read_bytes(), path))


def check(recording: Recording, signals: dict[str, tuple[list[float], str]], times: list[float] = T) -> None:
    """Assert the roles, values, units and times of the signals."""
    assert [signal.role for signal in recording.signals] == list(signals)
    for signal in recording.signals:
        values, unit = signals[signal.role]
        assert signal.unit == unit
        np.testing.assert_allclose(signal.values, values, rtol=1e-12)
        np.testing.assert_allclose(signal.times, times, rtol=1e-12, atol=1e-12)


# texts with the same record T, X in metres

HEAD = "t [s],x [m]\n"
SAME: dict[str, str | bytes] = {
    "commas": HEAD + rows(),
    "semicolons": "t [s];x [m]\n" + rows(";"),
    "tabs": "t [s]\tx [m]\n" + rows("\t"),
    "blanks": "t [s]  x [m]\n" + rows("   "),
    "blanks, and single blanks in the header": "t [s] x [m]\n" + rows(" "),
    "commas and blanks": "t [s], x [m]\n" + rows(",  "),
    "decimal commas after semicolons": "t [s];x [m]\n" + rows(";", ","),
    "decimal commas after tabs": "t [s]\tx [m]\n" + rows("\t", ","),
    "decimal commas after blanks": "t [s]  x [m]\n" + rows("  ", ","),
    "decimal commas in quotes": HEAD + '"0,0","1,0"\n"0,5","-2,25"\n"1,0","3,5"\n"2,5","0,125"\n',
    "sections": "[Header]\nrate = 2\n[Data]\nt [s];x [m]\n" + rows(";"),
    "units after commas": '"time, s";"position, m"\n' + rows(";"),
    "a quoted header": '"t [s]","x [m]"\n' + rows(),
    "quoted numbers": HEAD + "\n".join(f'"{t}","{x}"' for t, x in zip(T, X, strict=True)),
    "a comma inside a quoted header": '"time, s","position, m"\n' + rows(),
    "separators at the end of lines": "t [s],x [m],\n" + rows().replace("\n", ",\n"),
    "separators at the end of rows alone": HEAD + rows().replace("\n", ",,\n"),
    "a byte order mark": "\ufeff" + HEAD + rows(),
    "UTF-16 with a mark": ("t [s]\tx [m]\n" + rows("\t")).encode("utf-16"),
    "UTF-16 without a mark": ("t [s]\tx [m]\n" + rows("\t")).encode("utf-16-le"),
    "UTF-16 of the other end": ("t [s]\tx [m]\n" + rows("\t")).encode("utf-16-be"),
    "Latin-1": f"Prüfstand, 20 °C\n{HEAD}{rows()}".encode("latin-1"),
    "zeros at the end of the file": HEAD + rows() + 20 * "\x00",
    "Windows lines": (HEAD + rows()).replace("\n", "\r\n"),
    "old Macintosh lines": (HEAD + rows()).replace("\n", "\r"),
    "blank lines": (HEAD + rows()).replace("\n", "\n\n"),
    "comments": "# rig 3\n% Monday\n" + HEAD + "! begun\n" + rows() + "# done\n",
    "a header in a comment": "# rig 3\n# t [s], x [m]\n" + rows(),
    "a header in a comment, of other separators": "# t [s], x [m]\n" + rows(" "),
    "a comment between rows": HEAD + rows().replace("\n", "\n# pause\n", 2),
    "a preamble of names and numbers": "Rate,2\nOperator,none,really\nDate: Monday\n\n" + HEAD + rows(),
    "a preamble with its own table": "gain,1\noffset,0\n" + HEAD + rows(),
    "a line of units": "time,position\n(s),(m)\n" + rows(),
    "a line of bare units": "time\tposition\ns\tm\n" + rows("\t"),
    "a ruling below the header": "t [s]   x [m]\n-----   -----\n" + rows("   "),
    "seconds in words": "Time (sec),Displacement (metres)\n" + rows(),
    "milliseconds": "time_ms,x_mm\n" + rows(times=[1000 * t for t in T], values=[1000 * x for x in X]),
    "suffixes": "t_s,x_m\n" + rows(),
    "strokes": "Time/s,Position/m\n" + rows(),
    "capitals": "TIME (S),X (MM)\n" + rows(values=[1000 * x for x in X]),
    "micrometres in Greek": "t [µs];x [μm]\n" + rows(";", times=[1e6 * t for t in T], values=[1e6 * x for x in X]),
    "Fortran exponents": "t [s] x [m]\n0.0D0 1.0D+00\n5.0D-01 -2.25d0\n.1D1 3.5\n2.5 1.25D-1\n",
    "a minus sign of print": HEAD + rows().replace("-", "−"),
    "columns in the other order": "x [m],t [s]\n" + rows(times=X, values=T),
    "an index without a name": ",t [s],x [m]\n" + "".join(f"{i},{row}\n" for i, row in enumerate(rows().split())),
    "a column of words": "t [s],x [m],state\n" + rows().replace("\n", ",on\n"),
    "a column of the time of day": "clock,t [s],x [m]\n"
    + "".join(f"12:00:0{i},{row}\n" for i, row in enumerate(rows().split())),
    "words below the table": HEAD + rows() + "end of record\n",
    "a last row that is cut short": HEAD + rows() + "2.",
    "a clock that does not start at zero": HEAD + rows(times=[100 + t for t in T]),
    "a row written twice": HEAD + rows().replace("0.5,-2.25\n", "0.5,-2.25\n0.5,-2.25\n"),
    "a trial column with one trial": "trial,t [s],x [m]\n" + "".join(f"3,{row}\n" for row in rows().split()),
}


@pytest.mark.parametrize("case", SAME)
def test_texts_with_the_same_record(case: str, tmp_path: Path) -> None:
    check(read(write(tmp_path, SAME[case])), {"x": (X, "m")})


@pytest.mark.parametrize("missing", ["", "nan", "NaN", "NA", "-", "n/a", "inf"])
def test_missing_values_are_ignored_with_a_note(missing: str, tmp_path: Path) -> None:
    recording = read(write(tmp_path, f"t [s],x [m],f [kN]\n0,1,1\n1,{missing},2\n2,3,3\n3,4,4\n{missing},9,9\n"))
    x, f = recording.signals
    np.testing.assert_allclose(x.times, [0, 2, 3])
    np.testing.assert_allclose(x.values, [1, 3, 4])
    np.testing.assert_allclose(f.values, [1000, 2000, 3000, 4000])
    assert any("x: 1 of 4 values are missing" in note for note in recording.notes)
    assert any("rows without a time are ignored: 1 of 5" in note for note in recording.notes)


# units and roles

SIGNALS: dict[str, tuple[str, str, str, float, str]] = {
    "velocity": ("v [m/s]", "v", "velocity", 1.0, "m/s"),
    "velocity in mm": ("Velocity (mm/s)", "v", "velocity", 1e-3, "m/s"),
    "velocity as a suffix": ("speed_m_per_s", "v", "velocity", 1.0, "m/s"),
    "acceleration in g": ("Acceleration (g)", "a", "acceleration", 9.80665, "m/s²"),
    "g without a word for it": ("Channel 1 (g)", "a", "acceleration", 9.80665, "m/s²"),
    "acceleration in print": ("a (m/s²)", "a", "acceleration", 1.0, "m/s²"),
    "acceleration in ASCII": ("Linear Acceleration x (m/s^2)", "a", "acceleration", 1.0, "m/s²"),
    "acceleration with a second bracket": ("acc (mm/(s^2))", "a", "acceleration", 1e-3, "m/s²"),
    "acceleration as a suffix": ("acc_m_s2", "a", "acceleration", 1.0, "m/s²"),
    "gal": ("a [gal]", "a", "acceleration", 0.01, "m/s²"),
    "force": ("Force/N", "f", "force", 1.0, "N"),
    "millinewtons": ("force [mN]", "f", "force", 1e-3, "N"),
    "meganewtons": ("force [MN]", "f", "force", 1e6, "N"),
    "pounds": ("load (lbf)", "f", "force", 4.4482216152605, "N"),
    "torque": ("Torque [Nm]", "f", "force", 1.0, "N·m"),
    "torque in print": ("torque (N·m)", "f", "force", 1.0, "N·m"),
    "nanometres": ("x [nm]", "x", "displacement", 1e-9, "m"),
    "inches": ("position_in", "x", "displacement", 0.0254, "m"),
    "degrees": ('"Angle, deg"', "x", "displacement", DEGREE, "rad"),
    "degrees in print": ("angle (°)", "x", "displacement", DEGREE, "rad"),
    "radians as a suffix": ("theta_rad", "x", "displacement", 1.0, "rad"),
    "radians inside a name": ("theta_rad_from_hanging_rest", "x", "displacement", 1.0, "rad"),
    "revolutions": ("x [rev]", "x", "displacement", 2 * math.pi, "rad"),
    "turning speed": ("omega (rpm)", "v", "velocity", math.pi / 30, "rad/s"),
    "degrees a second": ("gyro [deg/s]", "v", "velocity", DEGREE, "rad/s"),
    "the second DOF": ("x2 [mm]", "x2", "displacement", 1e-3, "m"),
}


@pytest.mark.parametrize("case", SIGNALS)
def test_the_unit_in_a_header_determines_the_quantity(case: str, tmp_path: Path) -> None:
    header, role, measures, size, unit = SIGNALS[case]
    motion, nine = ("x [m],", "9,") if role == "f" else ("", "")  # a record needs a motion
    lines = [f"{t},{nine}{x}" for t, x in zip(T, X, strict=True)]
    signal = read(write(tmp_path, f"t [s],{motion}{header}\n" + "\n".join(lines))).signals[-1]
    assert (signal.role, signal.measures, signal.unit) == (role, measures, unit)
    assert signal.dof == (1 if role == "x2" else 0)
    np.testing.assert_allclose(signal.values, [size * x for x in X], rtol=1e-12)
    np.testing.assert_allclose(signal.times, T)


@pytest.mark.parametrize(
    ("header", "unit"),
    [
        ("q_m", ""),
        ("V_in", ""),
        ("x_in", ""),
        ("t_min", ""),
        ("dac_rev", ""),
        ("Input/Output", ""),
        ("force [mn]", "mn"),
        ("x [M]", "M"),
        ("x [NM]", "NM"),
        ("valid (yes)", "yes"),
        ("theta_deg_s", ""),
    ],
)
def test_ambiguous_suffixes_are_not_units(header: str, unit: str) -> None:
    column = column_of(header, np.zeros(1))
    assert column.unit is None
    assert column.label == unit


@pytest.mark.parametrize("header", ["Mass (g)", "velocity [mm]", "Force (m/s²)", "temp (°)"])
def test_a_name_that_contradicts_its_unit_is_ambiguous(header: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"add e\.g\. columns=t:0,x:1"):
        read(write(tmp_path, f"t [s],{header}\n" + rows()))


def test_spellings_of_units() -> None:
    for text in ("m/s²", "m/s^2", "m/s2", "m / s**2", "m·s⁻²", "m/s/s", "m/sec^2"):
        unit = unit_of(text)
        assert unit is not None
        assert (unit.measures, unit.size) == ("acceleration", 1.0)
    for text in ("V", "counts", "px", "", "m/s3", "kg", "1/s", "Hz"):
        assert unit_of(text) is None


def test_all_columns_with_known_units_are_read(tmp_path: Path) -> None:
    text = "t [ms],x [mm],v [m/s],Accel (g),F [kN],valid\n0,1,2,3,4,1\n500,2,3,4,5,1\n1500,-3,4,5,6,0\n"
    recording = read(write(tmp_path, text))
    g = 9.80665
    expected = {
        "x": ([1e-3, 2e-3, -3e-3], "m"), "v": ([2.0, 3.0, 4.0], "m/s"), "a": ([3 * g, 4 * g, 5 * g], "m/s²"),
        "f": ([4e3, 5e3, 6e3], "N"),
    }  # fmt: skip
    check(recording, expected, [0.0, 0.5, 1.5])
    assert [note for note in recording.notes if "5 'valid'" in note]


@pytest.mark.parametrize("names", [("x1", "x2"), ("ch1", "ch2"), ("Channel 1", "Channel 2"), ("theta_1", "theta_2")])
def test_numbered_columns_are_several_dofs(names: tuple[str, str], tmp_path: Path) -> None:
    first, second = names
    text = f"t [s],{second} [mm],{first} [mm]\n0,20,10\n1,21,11\n2,22,12\n"
    recording = read(write(tmp_path, text))
    signals = {signal.role: (signal.dof, signal.values.tolist()) for signal in recording.signals}
    assert signals == {"x1": (0, [0.01, 0.011, 0.012]), "x2": (1, [0.02, 0.021, 0.022])}


def test_only_the_specified_columns_are_read(tmp_path: Path) -> None:
    path = write(
        tmp_path, "trial,t,x,v,y [px]\n" + "".join(f"0,{t},{x},9,{2 * x}\n" for t, x in zip(T, X, strict=True))
    )
    options = {"columns": {"t": 1, "x": 2}, "units": {"t": "s", "x": "mm"}}
    check(read(path, **options), {"x": ([1e-3 * x for x in X], "m")})
    check(read(path, columns={"t": "t", "x": "y"}, units={"t": "s"}), {"x": ([2 * x for x in X], "px")})
    check(read(path, columns={"t": "t", "a": "y [px]"}, units={"t": "s"}), {"a": ([2 * x for x in X], "px")})
    check(read(path, columns={"x": 2}, units={"x": "counts"}, rate=4), {"x": (X, "counts")}, [0, 0.25, 0.5, 0.75])


def test_units_can_be_specified_for_clear_names(tmp_path: Path) -> None:
    path = write(tmp_path, "t,x\n" + rows())
    check(read(path, units={"t": "s", "x": "cm"}), {"x": ([0.01 * x for x in X], "m")})
    check(read(path, units={"t": "ms", "x1": "deg"}), {"x": ([DEGREE * x for x in X], "rad")}, [1e-3 * t for t in T])


def test_a_unit_that_differs_from_the_header_is_noted(tmp_path: Path) -> None:
    recording = read(write(tmp_path, "t [s],x [V]\n" + rows()), units={"x": "mm"})
    check(recording, {"x": ([1e-3 * x for x in X], "m")})
    assert "x: unit mm (from units=) replaces V (from the header)" in recording.notes


def test_a_single_column_needs_a_rate_and_a_unit(tmp_path: Path) -> None:
    path = write(tmp_path, "trigger_deg, rate, duration\n90, 1000, 5 \n-90.36\n-90.64\n-90.91\n-91.18\n")
    recording = read(path, rate=1000, units={"x": "deg"})
    values = [DEGREE * x for x in (-90.36, -90.64, -90.91, -91.18)]
    check(recording, {"x": (values, "rad")}, [0, 0.001, 0.002, 0.003])
    assert recording.notes == ("numbers above the table are ignored: row 2, 90, 1000, 5",)


# times

LATE = np.where(np.arange(870) % 51 == 40, np.arange(-1, 869), np.arange(870)) / 30
ROUNDED: dict[str, tuple[np.ndarray, float, float, str]] = {
    "milliseconds": (np.round(0.467 + np.arange(757) / 119.944, 3), 1.0, 119.944, "stamps are rounded to 0.001 s"),
    "tenths": (np.round(np.arange(900) / 30, 1), 1.0, 30.0, "of 900 time stamps are repeated"),
    "hundredths": (np.round(np.arange(900) / 300, 2), 1.0, 300.0, "of 900 time stamps are repeated"),
    "occasionally late": (np.round(LATE, 3), 1.0, 30.0, "17 of 870 time stamps are repeated"),
    "since 1970": (1.7e12 + np.round(np.arange(500) / 0.12), 1e-3, 120.0, "stamps are rounded to 0.001 s"),
    "32 bits": (np.float32(1000 + np.arange(5000) / 2000).astype(float), 1.0, 2000.0, "stamps are rounded to"),
    "three digits": (np.array([float(f"{i / 29.97:.3g}") for i in range(900)]), 1.0, 29.97, "399 of 900 time stamps"),
}
"""Stamps, their unit (s), the true sampling rate (Hz), and part of the note."""


@pytest.mark.parametrize("case", ROUNDED)
def test_rounded_stamps_are_replaced_by_even_ones(case: str) -> None:
    stamps, unit, rate, part = ROUNDED[case]
    times, (note,) = rebuilt(stamps, unit)
    np.testing.assert_allclose(times - times[0], np.arange(stamps.size) / rate, rtol=1e-3, atol=1e-6)
    assert part in note
    assert f"times are replaced by even ones at {rate:.4g}" in note


def test_dropped_frames_remain_a_gap(tmp_path: Path) -> None:
    true = np.delete(np.arange(300) / 30, [50, 51, 52, 200])
    recording = read(write(tmp_path, "t [s],x [mm]\n" + "".join(f"{t:.3f},1\n" for t in true)))
    np.testing.assert_allclose(recording.signals[0].times, true, atol=2e-4)
    assert "2 gaps in time, in which 4 samples at intervals of 0.03333 s are missing" in recording.notes
    exact = write(tmp_path, "t [s],x [mm]\n" + "".join(f"{t!r},1\n" for t in np.delete(GRID, [5, 6]).tolist()))
    np.testing.assert_array_equal(read(exact).signals[0].times, np.delete(GRID, [5, 6]))


def test_uneven_sampling_is_preserved(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    times = np.round(np.sort(rng.uniform(0, 10, 300)), 3)
    times = np.unique(times)
    recording = read(write(tmp_path, "t [s],x [mm]\n" + "".join(f"{t:.3f},1\n" for t in times)))
    np.testing.assert_allclose(recording.signals[0].times, times - times[0], atol=1e-12)
    assert recording.notes == ()


def test_even_sampling_is_preserved() -> None:
    for stamps in (GRID, GRID + 1e6, np.arange(1000) / 1024, np.arange(50.0)):
        times, notes = rebuilt(stamps, 1.0)
        np.testing.assert_array_equal(times, stamps)
        assert notes == []


def test_a_part_is_selected_on_the_clock_of_the_record(tmp_path: Path) -> None:
    path = write(tmp_path, "t [ms],x [mm]\n" + "".join(f"{t},{t}\n" for t in range(1000, 1100)))
    x = read(path, start=1.01, end=1.05).signals[0]
    np.testing.assert_allclose(x.values, np.arange(1010, 1051) / 1000)
    np.testing.assert_allclose(x.times, np.arange(41) / 1000, atol=1e-12)
    for options, part in [({"start": 0.5}, "from=0.5"), ({"end": 2.0}, "to=2.0"), ({"start": 7.0}, "from=7.0")]:
        with pytest.raises(InputError, match=r"runs from 1 to 1\.099 s") as error:
            read(path, **options)
        assert str(error.value).startswith(part)


@pytest.mark.parametrize(("rate", "phase", "n"), [(30, 0.37, 600), (29.97, 0.71, 600), (3, 0.2, 60), (12.3, 0.9, 200)])
def test_the_rate_of_whole_seconds_has_its_uncertainty(rate: float, phase: float, n: int, tmp_path: Path) -> None:
    stamps = np.floor(phase + np.arange(n) / rate).astype(int)
    text = "t [s],x [mm]\n" + "".join(f"{t},{math.sin(i)}\n" for i, t in enumerate(stamps))
    recording = read(write(tmp_path, text))
    error = 1 / np.diff(recording.signals[0].times).mean() / rate - 1
    assert abs(error) < 2 * recording.rate_error
    assert 1 / n / 6 < recording.rate_error < 1 / n
    assert "known to" in recording.notes[0]


def test_two_distinct_stamps_do_not_determine_the_rate(tmp_path: Path) -> None:
    text = "t [s],x [mm]\n" + "".join(f"{i // 20},{math.sin(i)}\n" for i in range(40))
    with pytest.raises(InputError, match="2 distinct time stamps determine the sampling rate only to"):
        read(write(tmp_path, text))
    assert read(write(tmp_path, text.replace("t [s]", "frame")), columns={"x": 1}, rate=20).rate_error == 0.0


@pytest.mark.parametrize("header", ["dt [ms]", "t [ms]", "Time since last (ms)"])
def test_time_increments_are_summed(header: str, tmp_path: Path) -> None:
    gaps = np.random.default_rng(0).choice([19, 20, 20, 21], 300)
    gaps[0] = 0
    text = f"a [m/s^2],{header}\n" + "".join(f"{math.sin(i / 5)},{gap}\n" for i, gap in enumerate(gaps))
    recording = read(write(tmp_path, text))
    np.testing.assert_allclose(recording.signals[0].times, np.cumsum(gaps) / 1000, atol=1e-9)
    assert "contains time increments, which were summed" in recording.notes[0]
    assert recording.rate_error == pytest.approx(1 / (20 * math.sqrt(12 * 299)), rel=0.01)


CELLS = [f"{i} {t} {x}" for i, (t, x) in enumerate(zip(T, X, strict=True))]
MATRIX = "[ Sample  Time  Position ;\n" + "".join(f"  {row};\n" for row in CELLS)
MATRICES = {
    "as printed": MATRIX + "]\n",
    "with a name": "M = " + MATRIX + "];\n",
    "comments around it": "% rig 3\n" + MATRIX.replace(" ;\n", " ;\n// begun\n") + "];\n",
    "in one line": f"% Sample Time Position\n[{'; '.join(CELLS)}]",
    "without brackets": MATRIX[2:].replace("Position ;", "Position;"),
}


@pytest.mark.parametrize("case", MATRICES)
def test_a_matrix_written_as_text(case: str, tmp_path: Path) -> None:
    check(read(write(tmp_path, MATRICES[case]), units={"t": "s", "x": "m"}), {"x": (X, "m")})


# arrays from Python


def test_dates_and_their_differences_are_times() -> None:
    start = datetime(2026, 11, 26, 12, 0, 0)
    moments = [start + timedelta(seconds=t) for t in T]
    stamps = np.array(moments, dtype="datetime64[ns]")
    berlin = [moment.replace(tzinfo=timezone(timedelta(hours=1))) for moment in moments]
    for times in (moments, stamps, berlin, pd.DatetimeIndex(moments), [m - start for m in moments], stamps - stamps[0]):
        recording = of_arrays(times, X)
        check(recording, {"x": (X, "m")})
        assert "converted to s since the first" in recording.notes[0]


def test_masked_samples_are_ignored_with_a_note() -> None:
    recording = of_arrays(np.arange(5.0), np.ma.masked_equal([1.0, -9.0, 3.0, 4.0, 5.0], -9.0))
    check(recording, {"x": ([1, 3, 4, 5], "m")}, [0, 2, 3, 4])
    assert "displacement: 1 of 5 samples are masked and ignored" in recording.notes
    masked = np.ma.masked_array(np.arange(5.0), [0, 0, 1, 0, 0])
    np.testing.assert_array_equal(of_arrays(masked, np.arange(5.0)).signals[0].times, [0, 1, 3, 4])


@pytest.mark.parametrize(
    ("times", "x", "part"),
    [
        (T, [1, 2, 3 + 1j, 4], "displacement=array: it contains complex numbers"),
        (T, np.array([1, 2, 3j, 4], dtype=object), "complex numbers"),
        (T, np.arange("2026-01-01", "2026-01-05", dtype="datetime64[D]"), "it contains dates"),
        (T, ["a", "b", "c", "d"], "numbers are needed"),
        (T, [1, 2, math.nan, 4], "displacement=array: sample 2 is not finite"),
        (T, [1, 2, 3], "a number for each time"),
        ([T, T], [X, X], "use a vector"),
        (["2026-01-01"] * 4, X, "times=array: numbers are needed"),
    ],
)
def test_invalid_arrays_are_rejected(times: Any, x: Any, part: str) -> None:
    with pytest.raises(InputError) as error:
        of_arrays(times, x)
    assert part in str(error.value)


def test_options_apply_to_arrays() -> None:
    options = ReadOptions(units={"t": "ms", "x": "mm"}, start=0.5e-3)
    recording = of_arrays(T, X, options=options)
    check(recording, {"x": ([1e-3 * x for x in X[1:]], "m")}, [0, 0.5e-3, 2e-3])


# several records in a file


RUN = [f"{i / 20},{math.cos(i):.5f}" for i in range(30)]
RUNS = {
    "time that starts again": "t [s],x [m]\n" + "\n".join(RUN + RUN[:20]),
    "a trial column": "trial,t [s],x [m]\n" + "\n".join([f"1,{r}" for r in RUN] + [f"2,{r}" for r in RUN[:20]]),
    "a trial column, and time that goes on": "run,t [s],x [m]\n"
    + "\n".join([f"1,{r}" for r in RUN] + [f"2,{i / 20},{math.cos(i - 30):.5f}" for i in range(30, 50)]),
}


@pytest.mark.parametrize("case", RUNS)
def test_runs_in_one_file_are_separate_records(case: str, tmp_path: Path) -> None:
    path = write(tmp_path, RUNS[case])
    first, second = read_recordings(path)
    x = np.round(np.cos(np.arange(30)), 5)
    check(first, {"x": (x.tolist(), "m")}, (np.arange(30) / 20).tolist())
    check(second, {"x": (x[:20].tolist(), "m")}, (np.arange(20) / 20).tolist())
    assert "run 2 of 2: rows 32 to 51" in second.notes
    assert second.source == f"{path} run 2"
    with pytest.raises(InputError, match="it has 2 runs"):
        read(path)


# errors

REJECTED: dict[str, tuple[str | bytes, dict[str, Any], str]] = {
    "a damaged gzip": (b"\x1f\x8b\x08\x00abc", {}, "gzip file is damaged"),
    "a damaged zip": (b"PK\x03\x04abc", {}, "damaged"),
    "a damaged Parquet": (b"PAR1abcPAR1", {}, "damaged"),
    "a damaged npy": (b"\x93NUMPY\x01\x00abc", {}, "damaged"),
    "MATLAB 7.3": (b"MATLAB 7.3 MAT-file" + bytes(200), {}, "save it with save(…, '-v7')"),
    "no units": ("t,x\n" + rows(), {}, "add units=t:s,x:mm"),
    "no unit of time": ("time,x [mm]\n" + rows(), {}, "the unit of t (column 0 'time') is unknown; add units=t:s"),
    "no unit of x": ("t [s],displacement\n" + rows(), {}, "add units=x:mm"),
    "no header": (rows(), {}, "add e.g. columns=t:0,x:1"),
    "named without units": (rows(), {"columns": {"t": 0, "x": 1}}, "add units=t:s,x:mm"),
    "no time": ("x [mm],f [N]\n" + rows(), {}, "add rate= (Hz)"),
    "named without a time": ("t [s],x [mm]\n" + rows(), {"columns": {"x": 1}}, "add rate= (Hz), or t:"),
    "a time alone": ("t [s]\n0\n1\n2\n3\n", {}, "a column of displacement, velocity or acceleration is needed"),
    "a rate beside a time": (HEAD + rows(), {"rate": 100}, "column 0 't [s]' contains the times; omit rate="),
    "two displacements": (
        "t [s],X (mm),Y (mm)\n0,1,2\n1,2,3\n2,3,4\n",
        {},
        "1 'X (mm)', 2 'Y (mm)'; add e.g. columns=t:0,x:1",
    ),
    "two times": ("t [s],time [ms],x [m]\n0,0,2\n1,1000,3\n2,2000,4\n", {}, "several columns may be the time"),
    "an angle and a way": ("t [s],angle (deg),v (mm/s)\n0,1,2\n1,2,3\n2,3,4\n", {}, "which are not one DOF"),
    "an unknown unit": ("t [s],x [px]\n" + rows(), {}, "or keep the unit with columns=t:0,x:1"),
    "an unknown unit of time": ("t [fortnight],x [m]\n" + rows(), {}, "add units=t:s"),
    "a label of the user without columns=": (
        "t [s],x\n" + rows(),
        {"units": {"x": "px"}},
        "name the column, e.g. columns=t:0,x:1",
    ),
    "a label of the time": (
        rows(),
        {"columns": {"t": 0, "x": 1}, "units": {"t": "frames", "x": "m"}},
        "supported: s, ms",
    ),
    "velocity as a force": (
        "t [s],v [m/s]\n" + rows(),
        {"columns": {"t": 0, "f": 1}},
        "measures velocity, not force; use the role v",
    ),
    "a velocity in mm": (
        "t [s],y\n" + rows(),
        {"columns": {"t": 0, "v": 1}, "units": {"v": "mm"}},
        "not a unit of velocity; supported: m/s",
    ),
    "a column that is not there": (
        HEAD + rows(),
        {"columns": {"t": 0, "x": 2}},
        "no such column; it has columns 0 't [s]', 1 'x [m]'",
    ),
    "a name that is not there": (HEAD + rows(), {"columns": {"t": "t", "x": "pos"}}, "columns=x:pos: no such column"),
    "one column twice": (HEAD + rows(), {"columns": {"x": 1, "v": 1}}, "has two roles"),
    "a column of words by number": (
        HEAD.replace("\n", ",s\n") + rows().replace("\n", ",on\n"),
        {"columns": {"t": 0, "x": 2}},
        "not numbers: on",
    ),
    "a unit for no column": (
        HEAD + rows(),
        {"units": {"f": "N"}},
        "no column has the role f; add e.g. columns=t:0,f:1",
    ),
    "a trial column": (
        "trial,t [s],x [m]\n" + "".join(f"{i % 2},{i},1\n" for i in range(6)),
        {},
        "numbers several records",
    ),
    "unsorted times": (HEAD + rows(times=[0.0, 2.0, 1.0, 3.0]), {}, "row 4: time decreases from 2 to 1; sort the rows"),
    "one time for all": (HEAD + rows(times=[1.0] * 4), {}, "row 3: time 1 occurs repeatedly"),
    "stamps that no rate explains": (
        HEAD + "0,1\n0.1,2\n0.5,3\n0.5,4\n3.1,5\n3.2,6\n9,7\n",
        {},
        "replace the time by rate=",
    ),
    "a word in a row": (HEAD + "0,1\n1,2\n2,two\n3,3\n4,4\n5,5\n6,6\n", {}, "row 4: 2 numbers are needed"),
    "a short row": (HEAD + "0.5,1\n1,2\n2,3\n3\n4,4\n5,5\n6,6\n7.5,7\n", {}, "row 5: 2 numbers are needed, not 3"),
    "two tables": (HEAD + rows() + "\nsecond\n" + HEAD + rows(), {}, "correct or delete this row"),
    "two samples": (HEAD + "0,1\n1,2\n", {}, "2 samples of x; at least 3"),
    "nothing but missing values": (
        "t [s],x [m],f [N]\n0,nan,1\n1,nan,2\n2,nan,3\n",
        {},
        "a column of displacement, velocity or acceleration is needed",
    ),
    "thousands": ("t [s];x [mm]\n1;1,234\n2;2,345\n3;3,456\n", {}, "the comma of 1,234 is ambiguous"),
    "a force alone": ("t [s],f [N]\n" + rows(), {}, "a column of displacement, velocity or acceleration is needed"),
    "one column with decimal commas": ("x [mm]\n0,5\n1,5\n-1,25\n", {"rate": 10}, "half as many with decimal commas"),
    "commas that separate and divide": (
        "t [s],x [mm]\n0,0,1,5\n0,5,2,5\n1,0,3,5\n",
        {},
        "half as many with decimal commas",
    ),
}


@pytest.mark.parametrize("case", REJECTED)
def test_errors_say_what_to_add(case: str, tmp_path: Path) -> None:
    content, options, part = REJECTED[case]
    with pytest.raises(InputError) as error:
        read(write(tmp_path, content), **options)
    assert part in str(error.value)
    assert "\n" not in str(error.value)


def test_too_large_files_are_rejected(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path, HEAD + rows())
    monkeypatch.setattr("bench.records.reading.table.MAX_ROWS", 3)
    with pytest.raises(InputError, match="4 rows; at most 3"):
        read(path)


@pytest.mark.parametrize(
    ("options", "part"),
    [
        ({"columns": {"y": 0}}, "columns=y: roles are t, x, v, a, f"),
        ({"units": {"x0": "m"}}, "units=x0: roles are"),
        ({"columns": {"x": 0, "x1": 1}}, "the same role"),
        ({"rate": 0.0}, "rate=0.0: a positive sampling rate"),
        ({"rate": math.nan}, "a positive sampling rate"),
        ({"end": math.inf}, "to=inf"),
        ({"decimate": 0}, "decimate=0: a whole number of at least 1"),
    ],
)
def test_invalid_options_are_rejected(options: dict[str, Any], part: str) -> None:
    with pytest.raises(InputError, match="=") as error:
        ReadOptions(**options)
    assert part in str(error.value)


def test_a_missing_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    in_this_process(monkeypatch)
    monkeypatch.setitem(sys.modules, "pyuff", None)
    with pytest.raises(InputError, match=r'pip install "vibration-bench\[files\]"'):
        read(write(tmp_path, "    -1\n    58\nNONE\n    -1\n"))


def test_the_source_of_a_recording_is_kept(tmp_path: Path) -> None:
    path = write(tmp_path, HEAD + rows())
    recording = read(path)
    assert recording.source == str(path)
    assert recording.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


# other kinds of file, written by their own libraries


def test_gzip_of_a_text(tmp_path: Path) -> None:
    check(read(write(tmp_path, gzip.compress((HEAD + rows()).encode()), name="r.csv.gz")), {"x": (X, "m")})


def test_a_workbook(tmp_path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.title = "about"
    book.active.append(["Rig 3", "Monday"])
    sheet = book.create_sheet("data")
    for line in (["made by", "nobody"], [], [None, "Time", "Position", "Force", "State"], [None, "(s)", "(mm)", "(N)"]):
        sheet.append(line)
    for i, (t, x) in enumerate(zip(T, X, strict=True)):
        sheet.append([None, t, x, None if i == 1 else 10 * x, "on"])
    path = tmp_path / "record.xlsx"
    book.save(path)
    recording = read(path)
    x, f = recording.signals
    np.testing.assert_allclose(x.values, [1e-3 * value for value in X])
    np.testing.assert_allclose(x.times, T)
    np.testing.assert_allclose(f.values, [10.0, 35.0, 1.25])
    np.testing.assert_allclose(f.times, [0.0, 1.0, 2.5])
    assert "the workbook has 2 sheets; 'data' was read" in recording.notes


def test_an_old_workbook(tmp_path: Path) -> None:
    xlwt = pytest.importorskip("xlwt")
    pytest.importorskip("xlrd")
    book = xlwt.Workbook()
    sheet = book.add_sheet("data")
    for i, row in enumerate([("t [s]", "x [mm]", "ok"), *zip(T, [1000 * x for x in X], [True] * 4, strict=True)]):
        for j, value in enumerate(row):
            sheet.write(i, j, value)
    book.save(str(tmp_path / "r.xls"))
    check(read(tmp_path / "r.xls"), {"x": (X, "m")})


@pytest.mark.parametrize("form", ["WAV", "FLAC", "AIFF"])
def test_sound_files(form: str, tmp_path: Path) -> None:
    sound = pytest.importorskip("soundfile")
    values = 0.5 * np.sin(np.arange(200) / 5)
    sound.write(tmp_path / "r", np.column_stack([values, -values]), 100, subtype="PCM_24", format=form)
    with pytest.raises(InputError, match=r"columns=x:1"):
        read(tmp_path / "r")
    recording = read(tmp_path / "r", columns={"a": "channel 2"}, units={"a": "g"})
    check(recording, {"a": (recording.signals[0].values.tolist(), "m/s²")}, GRID.tolist())
    np.testing.assert_allclose(recording.signals[0].values, -9.80665 * values, atol=1e-5)
    assert "fractions of full scale" in recording.notes[0]


def test_a_workbook_without_numbers(tmp_path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    openpyxl.Workbook().save(tmp_path / "empty.xlsx")
    with pytest.raises(InputError, match="no sheet has rows of numbers"):
        read(tmp_path / "empty.xlsx")


def test_matlab_variables_by_name(tmp_path: Path) -> None:
    path = tmp_path / "record.mat"
    inner = {"time": np.array([T]).T, "pair": np.array([X, [2 * x for x in X]])}
    scipy.io.savemat(
        path, {"t": T, "qm": np.array([X]).T, "fs": 2.0, "log": inner, "name": "rig", "long": np.arange(9)}
    )
    units = {"t": "s", "x": "mm"}
    check(read(path, columns={"t": "t", "x": "qm"}, units=units), {"x": ([1e-3 * x for x in X], "m")})
    check(read(path, columns={"t": "log.time", "x": "log.pair[1]"}, units=units), {"x": ([2e-3 * x for x in X], "m")})
    for options, part in [
        ({}, "t (4,), qm (4,), fs (), log.time (4,), log.pair (2, 4), name (no numbers), long (9,)"),
        ({"columns": {"t": "t", "x": "qg"}}, "no such column; it has variables t (4,)"),
        ({"columns": {"t": "t", "x": "long"}}, "columns of equal length are needed, but t has 4, x has 9"),
    ]:
        with pytest.raises(InputError) as error:
            read(path, **options)
        assert part in str(error.value)


def test_numpy_files(tmp_path: Path) -> None:
    np.savez(tmp_path / "r.npz", t_s=T, theta_deg=X, note="swing")
    check(read(tmp_path / "r.npz"), {"x": ([DEGREE * x for x in X], "rad")})
    np.save(tmp_path / "r.npy", np.array([T, X]).T)
    options = {"columns": {"t": 0, "x": 1}, "units": {"t": "s", "x": "m"}}
    check(read(tmp_path / "r.npy", **options), {"x": (X, "m")})
    np.save(tmp_path / "wide.npy", np.asfortranarray(np.array([T, X])))
    check(read(tmp_path / "wide.npy", **options), {"x": (X, "m")})
    fields = np.array(list(zip(T, X, strict=True)), dtype=[("t_s", "f8"), ("x_m", "f4")])
    np.save(tmp_path / "fields.npy", fields)
    check(read(tmp_path / "fields.npy"), {"x": (X, "m")})


def test_pickles_are_rejected(tmp_path: Path) -> None:
    np.save(tmp_path / "r.npy", np.array([{"t": 1}], dtype=object), allow_pickle=True)
    np.savez(tmp_path / "r.npz", t=np.array([{"t": 1}], dtype=object))
    for name in ("r.npy", "r.npz"):
        with pytest.raises(InputError, match="Python objects, which are not loaded"):
            read(tmp_path / name)


def test_a_header_of_a_huge_array_is_rejected(tmp_path: Path) -> None:
    buffer = io.BytesIO()
    np.lib.format.write_array_header_1_0(buffer, {"shape": (10**12,), "fortran_order": False, "descr": "<f8"})
    with pytest.raises(InputError, match="export the needed columns"):
        read(write(tmp_path, buffer.getvalue(), name="r.npy"))


def test_parquet(tmp_path: Path) -> None:
    schema = pa.schema(
        [pa.field("t [ms]", pa.int64()), pa.field("pos", pa.float32(), metadata={"unit": "mm"}), ("w", pa.string())]
    )
    table = pa.table([[0, 500, 1000, 2500], [1.0, -2.25, None, 0.125], ["a", "b", "c", "d"]], schema)
    pq.write_table(table, tmp_path / "r.parquet")
    recording = read(tmp_path / "r.parquet")
    check(recording, {"x": ([1e-3, -2.25e-3, 0.125e-3], "m")}, [0.0, 0.5, 2.5])
    assert "x: 1 of 4 values are missing and ignored" in recording.notes


# sizes are checked before reading


def sheet_of(rows_of_xml: str) -> bytes:
    """Return a workbook of one sheet with these rows."""
    openpyxl = pytest.importorskip("openpyxl")
    buffer, made = io.BytesIO(), io.BytesIO()
    openpyxl.Workbook().save(buffer)
    head = '<worksheet xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"><sheetData>'
    with zipfile.ZipFile(buffer) as book, zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in book.namelist():
            sheet = name == "xl/worksheets/sheet1.xml"
            archive.writestr(name, f"{head}{rows_of_xml}</sheetData></worksheet>" if sheet else book.read(name))
    return made.getvalue()


def mat_of(n: int) -> bytes:
    file = io.BytesIO()
    scipy.io.savemat(file, {f"v{i}": np.zeros(2**17) for i in range(n)}, do_compression=True)
    return file.getvalue()


def parquet_of(n: int) -> bytes:
    sink = io.BytesIO()
    pq.write_table(pa.table({f"v{i}": np.zeros(10**6) for i in range(n)}), sink)
    return sink.getvalue()


BOMBS = {
    "cells far to the right": (lambda: sheet_of('<row r="1"><c r="XFD1"><v>1</v></c></row>' * 9), "than 64 columns"),
    "many packed variables": (lambda: mat_of(300), "39321600 numbers; at most"),
    "many constant columns": (lambda: parquet_of(30), "30000000 numbers; at most 20000000"),
}  # fmt: skip


@pytest.mark.parametrize("case", BOMBS)
def test_small_files_of_large_tables_are_rejected(case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make, part = BOMBS[case]
    path = write(tmp_path, make())
    assert path.stat().st_size < 10**6
    in_this_process(monkeypatch)
    tracemalloc.start()
    with pytest.raises(InputError, match=part):
        read(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 100e6


def test_a_reader_that_needs_too_much_memory_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "MEMORY_MB", 1.0)
    np.savez_compressed(tmp_path / "r.npz", t=np.zeros(10**6))
    with pytest.raises(InputError, match="export the needed columns"):
        read(tmp_path / "r.npz")


def universal_set(values: np.ndarray, **other: Any) -> dict[str, Any]:
    given = {
        "type": 58, "binary": 0, "func_type": 1, "rsp_node": 3, "rsp_dir": 1, "ref_dir": 0, "ref_node": 0,
        "data": values, "x": GRID[: values.size], "id1": "rig", "rsp_ent_name": "NONE", "ref_ent_name": "NONE",
        "abscissa_spacing": 1, "abscissa_spec_data_type": 17, "ordinate_spec_data_type": 12,
        "ordinate_axis_units_lab": "g", "orddenom_spec_data_type": 0,
    }  # fmt: skip
    return {**given, **other}


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # pyuff leaves what it writes open
@pytest.mark.parametrize("binary", [0, 1])
def test_universal_files(binary: int, tmp_path: Path) -> None:
    pyuff = pytest.importorskip("pyuff")
    values = np.sin(np.arange(200.0))
    path = tmp_path / "r.uff"
    force = universal_set(2 * values, binary=binary, ordinate_spec_data_type=13, ordinate_axis_units_lab="N")
    pyuff.UFF(str(path)).write_sets([universal_set(values, binary=binary), force], "add")
    recording = read(path)
    a, f = recording.signals
    assert (a.role, a.measures, a.unit) == ("a", "acceleration", "m/s²")
    np.testing.assert_allclose(a.values, 9.80665 * values, rtol=1e-10)
    np.testing.assert_allclose(a.times, GRID, atol=1e-12)
    np.testing.assert_allclose(f.values, 2 * values, rtol=1e-10)
    only = read(path, columns={"f": 1})
    assert [signal.role for signal in only.signals] == ["f"]


def test_universal_files_without_units_or_with_two_sensors(tmp_path: Path) -> None:
    pyuff = pytest.importorskip("pyuff")
    values = np.sin(np.arange(200.0))
    path = tmp_path / "r.uff"
    pyuff.UFF(str(path)).write_sets([universal_set(values, ordinate_axis_units_lab="NONE")], "add")
    with pytest.raises(InputError, match="add units=a:g"):
        read(path)
    np.testing.assert_allclose(read(path, units={"a": "m/s²"}).signals[0].values, values, rtol=1e-10)
    path.unlink()
    pyuff.UFF(str(path)).write_sets([universal_set(values), universal_set(2 * values, rsp_node=4)], "add")
    with pytest.raises(InputError, match=r"measure acceleration: 0 'node 3', 1 'node 4'; add e\.g\. columns=a:1"):
        read(path)
    np.testing.assert_allclose(read(path, columns={"a2": 1}).signals[0].values, 2 * 9.80665 * values, rtol=1e-10)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # pyuff leaves what it writes open
def test_repeated_signals_in_a_universal_file_are_further_records(tmp_path: Path) -> None:
    pyuff = pytest.importorskip("pyuff")
    path = tmp_path / "r.uff"
    force = {"ordinate_spec_data_type": 13, "ordinate_axis_units_lab": "N", "rsp_node": 1}
    sets = [(k * np.ones(50), given) for k in (1, 2, 3) for given in (force, {})]
    pyuff.UFF(str(path)).write_sets([universal_set(values, **given) for values, given in sets], "add")
    runs = read_recordings(path)
    assert [[signal.role for signal in run.signals] for run in runs] == 3 * [["a", "f"]]
    assert [run.signals[1].values[0] for run in runs] == [1.0, 2.0, 3.0]
    assert [len(run.signals) for run in read_recordings(path, ReadOptions({"f": 2, "a": 3}))] == [2]


def test_frequency_responses_are_no_time_records(tmp_path: Path) -> None:
    pyuff = pytest.importorskip("pyuff")
    path = tmp_path / "r.uff"
    pyuff.UFF(str(path)).write_sets([universal_set(np.ones(50) * 1j, func_type=4, abscissa_spec_data_type=18)], "add")
    with pytest.raises(InputError, match="no time records; add modes=auto"):
        read(path)


def test_tdms(tmp_path: Path) -> None:
    nptdms = pytest.importorskip("nptdms")
    path = tmp_path / "r.tdms"
    wave = {"wf_increment": 0.01, "wf_start_offset": 2.0, "unit_string": "g"}
    with nptdms.TdmsWriter(str(path)) as writer:
        writer.write_segment([nptdms.ChannelObject("run", "Acc", np.arange(200.0), wave)])
    a = read(path).signals[0]
    assert (a.role, a.unit) == ("a", "m/s²")
    np.testing.assert_allclose(a.values, 9.80665 * np.arange(200.0))
    np.testing.assert_allclose(a.times, GRID, atol=1e-12)
