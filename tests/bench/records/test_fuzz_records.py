"""The fuzzer of records: a second; minutes with ``--hypothesis-profile=long``."""

from __future__ import annotations

from pathlib import Path

import pytest
from fuzz.records import AS_SEEDS, OPTIONS, RECORDS, SEEDS, check_record
from hypothesis import given

from bench.records.reading import ReadOptions, files, read_recording


@given(data=RECORDS, options=OPTIONS)
def test_a_record_is_read_or_rejected_in_one_line(data: bytes, options: ReadOptions, tmp_path: Path) -> None:
    with pytest.MonkeyPatch.context() as patch:  # separate processes would take minutes
        patch.setattr(files, "_table_of_child", lambda path: files._table(path.read_bytes(), path))
        check_record(data, options, tmp_path / "record")


@pytest.mark.parametrize("name", SEEDS)
def test_undamaged_records_of_the_fuzzer_are_valid(name: str, tmp_path: Path) -> None:
    """Otherwise damaged ones would fail the first checks only."""
    (tmp_path / "record").write_bytes(SEEDS[name])
    assert read_recording(tmp_path / "record", AS_SEEDS).signals[0].values.size == 60
