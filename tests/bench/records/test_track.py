"""Measured track: scores of siblings in closed form, storage of fits, and missing records."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from bench import InputError
from bench.commands.declaration import read_arguments
from bench.commands.measured_track import measured
from bench.engine import pool
from bench.records.free_run import free_run_error, free_runs, span_problem
from bench.records.intervals import StatedInterval
from bench.records.reading import Recording, Signal
from bench.records.sets import Known, MeasuredSet, measured_set, set_names
from bench.records.siblings import compare_siblings, total
from bench.records.track import pieces, tasks
from bench.reporting.tables.track_table import TrackPanel, method_rows, track_table
from bench.store.results import write_result

HALF = 1.959964
TINY = {"title": "t", "licence": "none", "source": "here", "folder": "x", "files": ["x.csv"], "systems": ["sdof"]}


def stated(value: float, error: float, white: float) -> StatedInterval:
    """Return an interval with standard errors of the logarithm, for repeat and record, and assuming white noise."""
    ends = [value * math.exp(sign * HALF * e) for e in (error, error, white) for sign in (-1.0, 1.0)]
    return StatedInterval(value, *ends, "")


def frame(*intervals: StatedInterval) -> pd.DataFrame:
    """Return the intervals of siblings."""
    return pd.DataFrame([asdict(interval) for interval in intervals])


def row(sibling: str, interval: StatedInterval, trust: str = "trust") -> dict[str, Any]:
    """Return the row of a fit with an interval of k/m."""
    head = {"sibling": sibling, "method": "ls", "status": "ok", "trust": trust, "quantity": "k_over_m"}
    return {**head, "withdrawn": int(trust == "do not trust"), "held_out": 90.0, "wall_s": 1.0, **asdict(interval)}


def test_siblings_that_scatter_as_stated() -> None:
    """The logarithms 0, 1, 2 have the standard deviation 1; the means of the others are 1.5, 1, 0.5.

    The score of an interval of half-width h is ``2 h + 40 max(d - h, 0)`` at the distance d from the mean, here 1.5, 0
    and 1.5: 2 h for the ideal one with h = 1.96, and ``0.98 + (2/3) 40 (1.5 - 0.49)`` assuming white noise.
    """
    scores = compare_siblings(frame(*(stated(math.exp(v), 1.0, 0.25) for v in (0.0, 1.0, 2.0))), known=2 * math.e)
    assert (scores["ratio_repeat"], scores["ratio_white"]) == pytest.approx((1.0, 4.0), rel=1e-5)
    assert (scores["covered_repeat"], scores["covered_white"], scores["counted"]) == (3, 1, 3)
    assert scores["score_repeat"] == pytest.approx(1.0, rel=1e-6)
    assert scores["score_white"] == pytest.approx((0.98 + 2 / 3 * 40 * (1.5 - 0.49)) / 3.92, rel=1e-3)
    assert scores["width_white"] == pytest.approx(math.exp(0.49), rel=1e-3)
    assert (scores["value"], scores["error_pct"]) == pytest.approx((math.e, 50.0))


def test_a_single_sibling_is_not_compared() -> None:
    scores = compare_siblings(frame(stated(9.0, 1.0, 1.0)))
    assert scores["counted"] == 0
    assert math.isnan(scores["ratio_repeat"])
    assert math.isnan(scores["error_pct"])


def test_missing_intervals_are_ignored_and_limits_are_counted() -> None:
    nothing = StatedInterval(100.0, *[math.nan] * 6, "")
    limit = StatedInterval(1.0, 0.0, 4.0, 0.0, 4.0, 0.1, 10.0, "", "at most")
    scores = compare_siblings(frame(stated(9.0, 1.0, 1.0), stated(10.0, 1.0, 1.0), nothing, limit))
    assert [scores[name] for name in ("n", "counted", "limits", "covered_repeat")] == [4, 2, 1, 2]


def test_totals_add_counts_and_take_medians() -> None:
    good = compare_siblings(frame(*(stated(math.exp(v), 1.0, 1.0) for v in (0.0, 1.0, 2.0))))
    bad = compare_siblings(frame(*(stated(math.exp(v), 0.1, 0.1) for v in (0.0, 2.0))))
    scores = total(pd.DataFrame([good, bad, compare_siblings(frame(stated(1.0, 1.0, 1.0)))]), "repeat")
    assert (scores["covered"], scores["counted"]) == (3, 5)
    assert scores["ratio"] == pytest.approx((1.0 + 2 / np.sqrt(2) / 0.1) / 2.0, rel=1e-5)
    assert scores["worst"] == bad["score_repeat"]
    assert scores["score"] == pytest.approx((1.0 + scores["worst"]) / 2.0)


def lines(files: Any) -> list[dict[str, str]]:
    """Return the rows of the CSV table."""
    return list(csv.DictReader(io.StringIO(files["table11.csv"])))


def test_withdrawn_estimates_are_counted_but_not_scored() -> None:
    rows = [row(str(v), stated(v, 1.0, 1.0), "do not trust" if v > 50 else "trust") for v in (9.0, 10.0, 99.0)]
    panel = TrackPanel.of_rows("s", MeasuredSet(**TINY), "sdof", rows)
    assert panel.agreements["counted"].tolist() == [2]
    files = track_table([panel], "again")
    assert "2 / 0 / 1" in files["table11.md"]
    assert "2 trust, 0 use with caution, 1 do not trust (rejected)" in files["table11.md"]
    assert [line["withdrawn"] for line in lines(files) if line["sibling"] == "all"] == ["1"]


def test_a_panel_without_estimates_has_its_rows() -> None:
    silent = {"sibling": "1", "method": "ls", "status": "diverged", "trust": "do not trust", "withdrawn": 0}
    files = track_table([TrackPanel.of_rows("s", MeasuredSet(**TINY), "sdof", [silent])], "again")
    assert "1 fits, 1 of them failed" in files["table11.md"]
    assert [(line["method"], line["status"]) for line in lines(files)] == [("ls", "diverged")]


def test_widths_against_certified_values() -> None:
    of = measured_set("mgh17")
    known = of.known["k_over_m"]
    assert known.sd is not None
    half = 2.0484071 * known.sd  # Student's t, 28 degrees of freedom
    interval = StatedInterval(known.value, *(0.0, 1.0) * 2, known.value - half, known.value + half, "")
    (text,), headers = method_rows(TrackPanel.of_rows("mgh17", of, "sdof", [row("1", interval)]))
    assert text[headers.index("k/m white/certified")] == "1.0000"
    assert text[headers.index("k/m error")] == "0 %"


def test_a_recording_is_cut_scaled_and_thinned() -> None:
    times = np.arange(12) * 0.5
    x = Signal("x", "displacement", 0, np.arange(12.0), "m", times)
    f = Signal("f", "force", 0, np.arange(12.0), "N", times)
    of = MeasuredSet(**TINY, parts=2, thin=3, thin_force=2, time_scale=0.2)
    first, second = pieces(Recording((x, f), (), "x.csv", ""), of)
    assert first.signals[0].values.tolist() == [0.0, 3.0]
    assert first.signals[0].times == pytest.approx([0.0, 0.3])
    assert second.signals[0].values.tolist() == [6.0, 9.0]
    assert second.signals[0].times == pytest.approx([0.0, 0.3])
    assert second.signals[1].values.tolist() == [6.0, 6.5, 8.5, 10.5, 11.0]
    assert second.signals[1].times == pytest.approx([0.0, 0.05, 0.25, 0.45, 0.5])


@pytest.mark.parametrize("name", set_names())
def test_sets_are_complete(name: str) -> None:
    """Every definition is valid; the files of packaged sets exist, with their provenance, and can be read."""
    of = measured_set(name)
    if not of.packaged:
        assert list(tasks(name, of, ["ls"], None, 60.0)) == []
        return
    assert (of.paths(None)[0].parent / "PROVENANCE.md").is_file()
    every = list(tasks(name, of, ["ls"], None, 60.0))
    assert len(every) == len(of.files) * of.parts * len(of.systems)
    assert len({task.key for task in every}) == len(every)
    assert all(20 < task.measured().problem.records[0].channels[0].n <= 1001 for task in every)


def test_an_unknown_set_is_rejected() -> None:
    with pytest.raises(InputError, match="known sets: airtrack"):
        measured_set("nowhere")


def tracked(arguments: Sequence[str]) -> int:
    """Run the experiment with the arguments of a command line."""
    return measured(**read_arguments(measured, arguments))


def test_the_command_resumes_from_stored_fits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    arguments = [f"store={tmp_path / 'kept'}", f"out={tmp_path}", "set=mgh17,silverbox", "method=output_error"]
    assert tracked(arguments) == 0
    text = (tmp_path / "table11.md").read_text(encoding="utf-8")
    assert "not found under data_root=: silverbox/SNLS80mV.csv.gz" in text
    assert "| 1.0000 " in text
    rows = list(csv.DictReader(io.StringIO((tmp_path / "table11.csv").read_text(encoding="utf-8"))))
    absent = [r["status"] for r in rows if r["set"] == "silverbox"]
    assert absent == ["not found under data_root=: silverbox/SNLS80mV.csv.gz"] * 2
    summary = [r for r in rows if r["quantity"] == "k_over_m" and r["sibling"] == "all"]
    assert float(summary[0]["error_pct"]) < 1e-3

    assert tracked([*arguments, "data_root=.", "dry_run=true"]) == 0
    assert tracked([a.replace("output_error", "ls") for a in arguments] + ["fit=false"]) == 0
    assert "1 fits are not made yet" in (tmp_path / "table11.md").read_text(encoding="utf-8")

    monkeypatch.setattr(pool, "Children", lambda preload: pytest.fail("it fits again"))
    assert tracked(arguments) == 0
    assert (tmp_path / "table11.md").read_text(encoding="utf-8") == text


def test_the_class_can_be_selected_automatically(tmp_path: Path) -> None:
    given = ["set=airtrack", "method=shooting", "system=auto", f"store={tmp_path}", f"out={tmp_path}"]
    assert tracked([*given, "dry_run=true"]) == 0
    of = measured_set("airtrack").model_copy(update={"systems": ["auto"]})
    task, *others = tasks("airtrack", of, ["ls"], None, 60.0)
    assert len(others) == 3
    stated = {row["quantity"]: row for row in task.rows()}
    assert stated["k_over_m"]["value"] == pytest.approx(6.2, rel=0.05)


def test_the_key_of_a_fit_depends_on_definition_and_settings(tmp_path: Path) -> None:
    """It does not depend on the title; a longer time limit matters only after a timeout."""
    of = measured_set("mgh17")
    (fit,) = tasks("mgh17", of, ["ls"], None, 60.0)
    (titled,) = tasks("mgh17", of.model_copy(update={"title": "other"}), ["ls"], None, 60.0)
    (thinned,) = tasks("mgh17", of.model_copy(update={"thin": 2}), ["ls"], None, 60.0)
    (weak,) = tasks("mgh17", of, ["ls_weak"], None, 60.0)
    assert fit.key == titled.key
    assert len({fit.key, thinned.key, weak.key}) == 3
    late = [{**fit.head, "status": "timeout", "timeout_s": 60.0, "held_out": math.nan}]
    write_result(tmp_path, fit.key, json.dumps(late).encode())
    assert fit.stored(tmp_path)
    stored = fit.read(tmp_path)
    assert stored is not None
    assert math.isnan(stored[0].pop("held_out"))
    assert not replace(fit, timeout_s=120.0).stored(tmp_path)
    assert not weak.stored(tmp_path)


def test_a_free_run_of_the_right_model_has_no_error(tmp_path: Path) -> None:
    """For ``m x'' = f`` with a constant force from rest, ``x = f t² / (2 m)``."""
    times = np.arange(200) * 0.01
    rows = "".join(f"{t:.17g},{0.5 * t * t:.17g},2.0\n" for t in times)
    (tmp_path / "x.csv").write_text("t (s),x (m),f (N)\n" + rows, encoding="utf-8")
    part = {"all": {"file": "x.csv"}}
    known = {"m": Known(value=1.0, source=""), "c": Known(value=1e-9, source="")}
    stated = {"systems": ["viscous"], "columns": "t:0,x:1,f:2", "tests": part, "known": known, "folder": "."}
    of = MeasuredSet(**{**TINY, **stated})
    system, record = span_problem(of, "viscous", of.tests["all"], tmp_path)
    assert free_run_error(system, {"m": 2.0, "c": 1e-9}, record) < 1e-8
    fits = [
        {"sibling": sibling, "method": "shooting", "quantity": name, "value": value, "offset": 0.0, "withdrawn": 0}
        for sibling, m in (("1", 2.0), ("2", 2.0), ("3", 5.0))
        for name, value in (("m", m), ("c", 1e-9))
    ]
    runs = dict(free_runs(of, "viscous", pd.DataFrame(fits[:-1]), tmp_path))  # the third sibling lacks c
    assert runs["shooting, median of 2 siblings"] == [pytest.approx(0.0, abs=1e-5)]
    wrong = 1e3 * float(np.sqrt(np.mean((0.5 * times**2) ** 2)))
    assert runs["published parameters"] == [pytest.approx(wrong, rel=1e-6)]
    assert list(free_runs(of, "viscous", pd.DataFrame(fits), None)) == []
