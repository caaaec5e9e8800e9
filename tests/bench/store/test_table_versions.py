"""Tables that are not made of cells state the versions that computed them, and are stale when one has changed."""

from __future__ import annotations

from pathlib import Path

import pytest

from bench.commands.main import main
from bench.commands.status import tables_lines
from bench.entrants.online import make_online
from bench.entrants.registry import load_method
from bench.store.table_versions import FILE, TableVersion, read_versions, with_table

LS, SDOF = ("bench.methods", "ls"), ("bench.systems", "sdof")


def stale(folder: Path) -> list[TableVersion]:
    return [line for line in read_versions(folder) if line.changed]


def test_a_table_is_stale_once_a_version_or_a_part_has_changed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for table in ("table10", "table11", "table10"):  # written twice: the lines of a table are replaced
        (tmp_path / FILE).write_text(with_table(tmp_path, table, {LS, SDOF, ("bench.methods", "gone")}))
    assert [line.table for line in read_versions(tmp_path)] == ["table10"] * 3 + ["table11"] * 3
    assert not stale(tmp_path)
    before = load_method("ls").version
    monkeypatch.setattr(load_method("ls"), "version", before + 1)
    assert [(line.table, line.changed) for line in stale(tmp_path)] == [
        (table, f"ls version {before}, today {before + 1}") for table in ("table10", "table11")
    ]
    monkeypatch.setattr(load_method("ls"), "version", before)
    monkeypatch.setattr(load_method("ls"), "parts", {"forces": 2})
    assert {line.changed for line in stale(tmp_path)} == {f"ls version {before}, today {before}; forces 2"}


def test_the_command_of_a_track_writes_them_and_status_says_what_is_stale(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    track = ["-m", "experiment=online", "scenario=constant_multisine", "method=ekf,window_ls", "fit=false"]
    assert main([*track, f"store={tmp_path / 'runs'}", f"out={tmp_path}"]) == 0
    versions = {line[1:3]: line.version for line in read_versions(tmp_path)}
    assert versions.keys() == {("bench.trackers", "ekf"), LS, SDOF}
    assert versions["bench.trackers", "ekf"] == str(make_online("ekf").version)
    monkeypatch.setattr(load_method("ls"), "version", 9)
    count, reason = tables_lines(tmp_path)
    assert count == "tracks and atlas: 1 table(s), 1 stale"
    assert reason.startswith("  stale: ls version ")
    assert "today 9" in reason
    assert "(table10)" in reason
    for name in ("table11.csv", "atlas_forced.csv.gz", "atlas.md"):
        (tmp_path / name).touch()
    assert tables_lines(tmp_path)[-1] == "  computed before tables stated versions: atlas_forced, table11"
