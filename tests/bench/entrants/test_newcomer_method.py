"""The tutorial's example of a new method, taken from its page to the letter, in a folder of its own."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from conftest import REPOSITORY, Python, StoreFactory, install

from bench.commands.main import main
from bench.conformance.method_checks import METHOD_CHECKS

PAGE = REPOSITORY / "docs" / "gallery" / "new_method.md"
POINTS = "[bench.methods]\nzero_crossings = zero_crossings:ZeroCrossings\nbroken = zero_crossings:Nowhere\n"
DAMPING_RATIO = 0.4 / (2 * 8**0.5)
"""``c / (2 sqrt(k m))`` of the reference system: m = 1 kg, c = 0.4 N s/m, k = 8 N/m."""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with the module of the page."""
    found = re.search(r"```python title=\"zero_crossings.py\"\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)
    assert found
    folder = tmp_path / "site"
    folder.mkdir()
    (folder / "zero_crossings.py").write_text(found.group(1), encoding="utf-8")
    return folder


def test_a_new_method_is_one_file(folder: Path, python: Python, new_store: StoreFactory) -> None:
    """It runs, is scored and stored by its entry point alone, with its field as a setting; one that is broken is named.

    It counts eight half periods of 1.11 s between samples 0.26 s apart: frequency within 3 %, k/m within 6 %. At the
    true damping ratio ``c/m = 2 ζ sqrt(k/m)`` is off by half as much.
    """
    store = new_store()
    env = install(folder, "zero_crossings", POINTS)
    setting = f"method.damping_ratio={DAMPING_RATIO}"
    arguments = ("method=zero_crossings", setting, "replicates=3", "workers=1", "format=json", f"store={store.folder}")
    done = python("-m", "bench", *arguments, env=env)
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout.strip().splitlines()[-1])
    assert (said["method"].split()[0], said["status"]) == ("zero_crossings", "ok"), said
    done = python("-m", "bench", "method=broken", f"store={store.folder}", env=env)
    assert done.returncode == 2
    assert done.stderr.startswith("bench: method=broken: could not import its entry point")
    assert len(done.stderr.splitlines()) == 1
    (stored,) = (store.load(identity) for identity in store.identities())
    assert stored.cell["settings"] == {"damping_ratio": pytest.approx(DAMPING_RATIO)}
    for row in stored.rows:
        ratio = row.scores["k_over_m_ratio"]
        assert ratio == pytest.approx(1.0, abs=0.06)
        assert row.scores["c_over_m_ratio"] == pytest.approx(ratio**0.5, rel=1e-4)


def test_it_keeps_the_contract(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What a reader copies passes the checks of anybody's method."""
    status, lines = main(["check", f"package={folder / 'zero_crossings.py'}"]), capsys.readouterr().out.splitlines()
    assert (status, lines[0]) == (0, "method zero_crossings (zero_crossings:ZeroCrossings)"), lines
    assert lines[-1] == f"{len(METHOD_CHECKS)} of {len(METHOD_CHECKS)} checks passed"
