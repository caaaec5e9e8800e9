"""Hammer blows and frequency responses from files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.contract.modal import Blows, FrequencyResponses
from bench.errors import InputError
from bench.records.forced_response import ForcedData, forced_motion, frequency_responses
from bench.records.modal_data import read_modal
from bench.records.reading import ReadOptions, read_recordings
from bench.records.reading.files import read_file
from bench.records.request import modal_request_of

pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # pyuff's open files
LINES = np.arange(0.0, 100.0, 0.5)
RESPONSES = np.array([1.0, -0.5])[:, None] / (60.0**2 - (2 * np.pi * LINES) ** 2 + 50j * LINES)


def written(path: Path, binary: int = 0, count: int = 2, **other: Any) -> Path:
    pyuff = pytest.importorskip("pyuff")
    sets = []
    for k, values in enumerate(RESPONSES[:count], 1):
        given = {
            "type": 58, "binary": binary, "func_type": 4, "rsp_node": k, "rsp_dir": 3, "ref_node": 1, "ref_dir": -3,
            "data": values, "x": LINES, "id1": "plate", "rsp_ent_name": "NONE", "ref_ent_name": "NONE",
            "abscissa_spacing": 1, "abscissa_spec_data_type": 18, "abscissa_axis_units_lab": "Hz",
            "ordinate_spec_data_type": 12, "ordinate_axis_units_lab": "g", "orddenom_spec_data_type": 13,
            "orddenom_axis_units_lab": "kN",
        }  # fmt: skip
        sets.append(given | {key: value[k - 1] if isinstance(value, tuple) else value for key, value in other.items()})
    pyuff.UFF(str(path)).write_sets(sets, "add")
    return path


def read(path: Path, **options: Any) -> ForcedData:
    response = options.pop("response", None)
    return frequency_responses(read_file(path)[0].spectra, path.name, ReadOptions(**options), response)


@pytest.mark.parametrize("binary", [0, 1])
def test_frequency_responses_are_converted_to_si_units_with_their_points(binary: int, tmp_path: Path) -> None:
    data, names, units, _ = read(written(tmp_path / "r.uff", binary))
    assert isinstance(data, FrequencyResponses)
    assert (data.response, names, units) == ("accelerance", ("1 +Z", "2 +Z"), ("m/s²", "m/s²"))
    np.testing.assert_allclose(data.frequencies, LINES[1:])  # the accelerance is zero at 0 Hz
    np.testing.assert_allclose(data.values, RESPONSES[:, 1:] * 9.80665 / 1e3, rtol=1e-6)


def test_a_roving_hammer_and_a_label_with_both_units(tmp_path: Path) -> None:
    path = written(
        tmp_path / "r.uff", rsp_node=7, ref_node=(4, 5), ordinate_spec_data_type=0, orddenom_spec_data_type=0,
        ordinate_axis_units_lab="(mm/s)/N", orddenom_axis_units_lab="NONE",
    )  # fmt: skip
    data, names, _, notes = read(path)
    assert isinstance(data, FrequencyResponses)
    assert (data.response, names) == ("mobility", ("4 -Z", "5 -Z"))
    assert any("reciprocity" in note for note in notes)
    np.testing.assert_allclose(data.values, RESPONSES[:, 1:] * 1e-3, rtol=1e-6)


@pytest.mark.parametrize(
    ("fields", "options", "message"),
    [
        ({"ordinate_spec_data_type": 0, "ordinate_axis_units_lab": "NONE"}, {}, "add response=receptance or"),
        ({}, {"response": "mobility"}, "contains accelerance; omit response="),
        ({"ordinate_axis_units_lab": "NONE"}, {}, "the unit of the acceleration is unknown; add units=a:g"),
        ({"orddenom_axis_units_lab": "V"}, {}, "units=f:V: not a unit of force"),
        ({"ordinate_spec_data_type": (12, 11), "ordinate_axis_units_lab": ("g", "m/s")}, {}, "responses of one kind"),
        ({"ordinate_spec_data_type": 13, "ordinate_axis_units_lab": "N"}, {}, "force over force"),
        ({"ref_node": (1, 2)}, {}, "a single point of force, or a single response"),
        ({"abscissa_axis_units_lab": "rpm"}, {}, "not a function of frequency in Hz"),
        ({"data": np.abs(RESPONSES[0])}, {}, "the values are real"),
        ({"x": (LINES, 2 * LINES)}, {}, "different frequencies"),
        ({"data": 0 * RESPONSES[0]}, {}, "0 lines; at least 16 are needed"),
    ],
)  # fmt: skip
def test_ambiguous_frequency_responses_are_rejected(
    fields: dict[str, Any], options: dict[str, Any], message: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=message):
        read(written(tmp_path / "r.uff", **fields), **options)


def test_units_and_kind_can_be_specified_and_a_truncated_file_is_rejected(tmp_path: Path) -> None:
    path = written(tmp_path / "r.uff", ordinate_spec_data_type=0, ordinate_axis_units_lab="NONE")
    data, *_ = read(path, response="receptance", units={"x": "mm"})
    np.testing.assert_allclose(data.values[0], RESPONSES[0, 1:] * 1e-6, rtol=1e-6)  # type: ignore[union-attr]
    text = path.read_text().splitlines(keepends=True)
    path.write_text("".join([*text[:40], "    -1\n"]))
    with pytest.raises(InputError, match="the header states"):
        read(path)


def hammered(path: Path, header: str = "t [s],f [N],a1 [g],a2 [g]", peaks: tuple[float, ...] = (50.0, 80.0)) -> Path:
    t = np.arange(6000) / 1000.0
    force = sum((p * np.exp(-0.5 * ((t - 0.5 - 3 * k) / 0.002) ** 2) for k, p in enumerate(peaks)), np.zeros(t.size))
    ring = np.convolve(force, np.exp(-3.0 * t) * np.sin(200.0 * t))[: t.size]
    np.savetxt(path, np.column_stack([t, force, ring, -ring]), delimiter=",", header=header, comments="")
    return path


def test_blows_of_two_files_of_several_sensors(tmp_path: Path) -> None:
    paths = hammered(tmp_path / "1.csv"), hammered(tmp_path / "2.csv", peaks=(40.0, 90.0))
    recordings = [recording for path in paths for recording in read_recordings(path)]
    data, names, units, notes = forced_motion(recordings, window=2.0)
    assert isinstance(data, Blows)
    assert (data.response, data.window, names, units) == ("accelerance", 2.0, ("a1", "a2"), ("m/s²", "m/s²"))
    np.testing.assert_allclose(np.max(data.forces, axis=1), (50.0, 80.0, 40.0, 90.0))
    assert data.responses.shape[:2] == (4, 2)
    assert any("exponential window, 2 1/s, is subtracted" in note for note in notes)


def test_all_blows_or_frequency_responses_of_a_request_form_one_record(tmp_path: Path) -> None:
    files = f"{hammered(tmp_path / '1.csv')},{hammered(tmp_path / '2.csv')}"
    (blows,) = read_modal(modal_request_of({"data": [files], "modes": ["auto"], "window": [1.5]}))
    assert isinstance(blows.data, Blows)
    assert (len(blows.data.forces), blows.data.window, blows.channels) == (4, 1.5, ("a1", "a2"))
    with pytest.raises(InputError, match="response=mobility: for frequency responses only"):
        read_modal(modal_request_of({"data": [files], "modes": ["auto"], "response": ["mobility"]}))
    with pytest.raises(InputError, match=r"band=10:900: the highest frequency of 1\.csv, 2\.csv is 500 Hz"):
        read_modal(modal_request_of({"data": [files], "modes": ["auto"], "band": ["10:900"]}))
    first, second = (written(tmp_path / f"{k}.uff", 1, 1, rsp_node=k) for k in (3, 4))
    (responses,) = read_modal(modal_request_of({"data": [f"{first},{second}"], "modes": ["2"]}))
    assert responses.channels == ("3 +Z", "4 +Z")
    with pytest.raises(InputError, match="add modes=auto to identify modes"):
        read_recordings(first)


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ("t [s],f1 [N],f2 [N],a [g]", "it has 2 forces; one is needed"),
        ("t [s],f [N],a [g],v [m/s]", "responses are acceleration and velocity|velocity and acceleration"),
    ],
)
def test_several_forces_or_kinds_of_response_are_rejected(header: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=message):
        forced_motion(read_recordings(hammered(tmp_path / "r.csv", header)))
