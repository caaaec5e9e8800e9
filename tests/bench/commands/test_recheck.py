"""A change that alters nothing keeps the cells; one that alters anything does not."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from stored import resealed

from bench.commands import recheck
from bench.config.experiment import expand
from bench.run.pool import Limits
from bench.scenario.scenario import Scenario
from bench.store.cell import Cell
from bench.store.locks import Claims
from bench.store.store import Store
from bench.store.stored import StoredCell
from bench.sweep.launch import complete

OLD = "0123456789abcdef"
N = 12


@pytest.fixture(scope="module")
def computed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The files of a cell of each method, by name."""
    store = Store(tmp_path_factory.mktemp("computed") / "rows")
    store.prepare()
    jobs = expand(["method=ls,matrix_pencil", f"replicates={N}", "system=sdof"], multirun=True)
    complete([job.cell() for job in jobs], store, Limits(1, 60.0))
    return {path.name: path.read_text() for path in store.folder.glob("*.json")}


@pytest.fixture
def store(computed: dict[str, str], tmp_path: Path) -> Store:
    store = Store(tmp_path / "rows")
    store.prepare()
    for name, text in computed.items():
        (store.folder / name).write_text(text)
    return store


def _edit(store: Store, method: str, **changes: Callable[[Any], Any]) -> Path:
    """Rewrite the file of a method's cell."""
    for path in store.folder.glob("*.json"):
        content = json.loads(path.read_text())
        if content["cell"]["method"] == method:
            for key, value in changes.items():
                content[key] = value(content[key])
            path.write_bytes(resealed(content))
            return path
    raise AssertionError(method)


def _older(version: dict[str, Any]) -> dict[str, Any]:
    return {**version, "digest": OLD}


def _vouched(replicates: Any) -> Callable[[dict[str, Any]], dict[str, Any]]:
    return lambda come: {**come, "rechecked": [{"replicates": replicates, "computed_by": OLD, "commit": None}]}


def _moved(replicate: int, by: float = 3e-4) -> Callable[[dict[str, Any]], dict[str, Any]]:
    """Its k/m error is moved by three parts in ten thousand of it: that can show in a table."""

    def moved(rows: dict[str, Any]) -> dict[str, Any]:
        name = "k_over_m_error_pct"
        values = [v + (by * max(map(abs, rows["scores"][name])) if i == replicate else 0.0)
                  for i, v in enumerate(rows["scores"][name])]  # fmt: skip
        return {**rows, "scores": {**rows["scores"], name: values}}

    return moved


def _digest(path: Path) -> str:
    return str(json.loads(path.read_text())["version"]["digest"])


def test_nothing_is_stale(store: Store, capsys: pytest.CaptureFixture[str]) -> None:
    assert recheck.main([f"store={store.folder}"]) == 0
    assert "no cell is stale" in capsys.readouterr().out


def test_where_only_the_summary_is_of_older_code_it_is_made_anew_and_nothing_is_fitted(
    store: Store, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def unbounded(summary: dict[str, Any]) -> dict[str, Any]:
        return {name: {**one, "bound": "nan"} for name, one in summary.items()}

    before = json.loads(_edit(store, "ls").read_text())
    path = _edit(store, "ls", version=_only_summary, summary=unbounded)
    monkeypatch.setattr(recheck, "run_replicates", None)
    assert recheck.main([f"store={store.folder}", "archive=none"]) == 0
    assert "1 cells: rows as they were" in capsys.readouterr().out
    after = json.loads(path.read_text())
    assert after["version"]["digest"] == before["version"]["digest"]
    assert after["rows"] == before["rows"]
    for name, one in before["summary"].items():
        for key, value in one.items():  # of rows with six digits each, where the first was of all digits
            assert float(after["summary"][name][key]) == pytest.approx(float(value), rel=1e-4, abs=1e-9, nan_ok=True)


def test_a_tenth_is_compared_and_five_at_least() -> None:
    assert [recheck.n_compared(n) for n in (1, 5, 6, 50, 51, 100, 500)] == [1, 5, 5, 5, 6, 10, 50]


def test_the_draw_is_repeatable_and_leaves_no_replicate_out() -> None:
    """Of 20 replicates 5 are drawn: each with probability 1/4 over cells, within five standard errors of 4,000."""
    cells, n = 4000, 20
    names = [f"{i:020x}" for i in np.random.default_rng(5).integers(2**60, size=cells)]
    draws = [recheck.draw(name, n) for name in names]
    assert draws == [recheck.draw(name, n) for name in names]
    assert all(len(set(draw)) == 5 for draw in draws)
    share = np.bincount(np.concatenate(draws), minlength=n) / cells
    assert share == pytest.approx(np.full(n, 0.25), abs=5 * math.sqrt(0.25 * 0.75 / cells))


@pytest.mark.parametrize(("n", "changed"), [(1, 1), (7, 1), (20, 1), (40, 2), (50, 3)])
def test_the_probability_of_a_miss_is_the_share_of_draws_without_a_changed_replicate(n: int, changed: int) -> None:
    """5 % rounded up are changed; all draws are counted."""
    size = recheck.n_compared(n)
    if n <= 20:
        missed = [not set(chosen) & set(range(changed)) for chosen in itertools.combinations(range(n), size)]
        assert recheck.miss_probability(n, size) == pytest.approx(np.mean(missed))
    product = math.prod((n - changed - i) / (n - i) for i in range(size))  # one draw after the other
    assert recheck.miss_probability(n, size) == pytest.approx(product)


def test_cells_that_come_out_the_same_are_kept_and_say_so(store: Store, capsys: pytest.CaptureFixture[str]) -> None:
    path = _edit(store, "ls", version=_older)
    before = json.loads(path.read_text())
    assert recheck.main([f"store={store.folder}"]) == 0
    said = capsys.readouterr().out
    assert "1 cells checked: 1 come out the same" in said
    assert f"ls: 1 cells, 5 of {N} replicates" in said
    assert "missed with probability 0.58 at most" in said  # 7/12: one of 12 is changed, 5 are looked at
    after = json.loads(path.read_text())
    assert after["rows"] == before["rows"]
    assert after["arrays"] == before["arrays"]
    (note,) = after["provenance"]["rechecked"]
    assert note["replicates"] == list(recheck.draw(path.stem, N))
    assert note["missed_5_percent"] == pytest.approx(7 / 12, rel=1e-5)
    assert note["computed_by"] == OLD
    assert not recheck.checks(store)


def test_a_changed_replicate_among_those_drawn_is_found(store: Store, capsys: pytest.CaptureFixture[str]) -> None:
    path = _edit(store, "ls", version=_older)
    last = recheck.draw(path.stem, N)[-1]
    assert last > 1
    _edit(store, "ls", rows=_moved(last))
    other = _edit(store, "matrix_pencil", version=_older)
    assert recheck.main([f"store={store.folder}"]) == 0
    said = capsys.readouterr().out
    assert f"{path.stem[:8]}  ls on sdof, 20 dB: comes out otherwise" in said
    assert "2 cells checked: 1 come out the same" in said
    assert _digest(path) == OLD
    assert _digest(other) != OLD


def test_a_replicate_that_says_something_else_is_found_and_one_with_other_digits_is_not(store: Store) -> None:
    _edit(store, "ls", version=_older)
    (check,) = recheck.checks(store)
    before = check.stored.rows
    drawn = [row for row in before if row.replicate in set(check.replicates)]

    def differs(stored: str, now: str) -> bool:
        cell = replace(check.stored, rows=[replace(row, message=stored) for row in before])
        rows = [replace(row, message=now) for row in drawn]
        return recheck.difference(replace(check, stored=cell), rows) > recheck.SAME

    assert not differs("1.33 times the value", "1.34 times the value")
    assert differs("", "do not trust it")


def test_the_last_bits_of_another_processor_are_no_change_and_their_size_is_noted(store: Store) -> None:
    path = _edit(store, "ls", version=_older)
    _edit(store, "ls", rows=_moved(recheck.draw(path.stem, N)[-1], by=1e-5))
    assert recheck.main([f"store={store.folder}"]) == 0
    assert _digest(path) != OLD
    assert 5e-6 < json.loads(path.read_text())["provenance"]["rechecked"][0]["largest_difference"] < 5e-5


def test_a_changed_replicate_is_missed_where_it_is_not_drawn(store: Store) -> None:
    """Which is what the stated probability says of itself."""
    path = _edit(store, "ls", version=_older)
    spared = next(i for i in range(N) if i not in recheck.draw(path.stem, N))
    _edit(store, "ls", rows=_moved(spared))
    assert recheck.main([f"store={store.folder}"]) == 0
    assert _digest(path) != OLD


def test_cells_vouched_for_on_few_replicates_are_checked_again(store: Store) -> None:
    few = _edit(store, "ls", provenance=_vouched(2))
    enough = _edit(store, "matrix_pencil", provenance=_vouched([0, 3, 4, 7, 9]))
    assert [check.stored.identity for check in recheck.checks(store)] == [few.stem]
    kept = enough.read_text()
    assert recheck.main([f"store={store.folder}"]) == 0
    old, new = json.loads(few.read_text())["provenance"]["rechecked"]
    assert (old["replicates"], len(new["replicates"])) == (2, 5)
    assert new["computed_by"] == OLD  # not by the code that vouched for it
    assert enough.read_text() == kept
    assert not recheck.checks(store)


def test_a_cell_wrongly_vouched_for_is_stale_again(store: Store) -> None:
    path = _edit(store, "ls", provenance=_vouched(2))
    _edit(store, "ls", rows=_moved(recheck.draw(path.stem, N)[-1]))
    assert recheck.main([f"store={store.folder}"]) == 0
    assert _digest(path) == OLD
    assert "rechecked" not in json.loads(path.read_text())["provenance"]


def test_an_interrupted_recheck_keeps_what_was_confirmed_and_goes_on(
    store: Store, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = [_edit(store, method, version=_older) for method in ("ls", "matrix_pencil")]
    difference, asked = recheck.difference, []

    def once(check: recheck.Check, rows: Any) -> float:
        asked.append(check)
        if len(asked) == 2:
            raise KeyboardInterrupt
        return difference(check, rows)

    monkeypatch.setattr(recheck, "difference", once)
    assert recheck.main([f"store={store.folder}"]) == 130
    assert "what was confirmed is kept" in capsys.readouterr().err
    assert sorted(_digest(path) == OLD for path in paths) == [False, True]
    assert recheck.main([f"store={store.folder}"]) == 0
    assert "1 cells checked: 1 come out the same" in capsys.readouterr().out
    assert all(_digest(path) != OLD for path in paths)


def test_a_recheck_of_some_methods_leaves_the_others(store: Store, capsys: pytest.CaptureFixture[str]) -> None:
    paths = [_edit(store, method, version=_older) for method in ("ls", "matrix_pencil")]
    assert recheck.main([f"store={store.folder}", "method=ls,rls"]) == 0
    assert [_digest(path) == OLD for path in paths] == [False, True]
    assert recheck.main([f"store={store.folder}", "experiment=table4"]) == 0  # the cells are none of its
    assert "no cell is stale" in capsys.readouterr().out
    assert _digest(paths[1]) == OLD


def test_a_cell_with_failures_is_not_vouched_for(store: Store) -> None:
    """A change may be the repair of just that failure."""
    _edit(store, "ls", version=_older, rows=lambda rows: {**rows, "status": ["crashed", *rows["status"][1:]]})
    assert not recheck.checks(store)


def test_bad_input_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert recheck.main([f"store={tmp_path}/none"]) == 2
    assert recheck.main(["replicates=2"]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 2


def _only_summary(version: dict[str, Any]) -> dict[str, Any]:
    return {**version, "digest": version["digest"].partition("-")[0] + "-" + OLD}


def _store_newer(path: Path) -> str:
    """As another run does; returns what the file holds then."""
    content = json.loads(path.read_text())
    path.write_bytes(resealed({**content, "wall_s": content["wall_s"] + 1.0}))
    return path.read_text()


def test_rows_that_another_run_stores_meanwhile_are_not_written_over(store: Store) -> None:
    path = _edit(store, "ls", version=_older)
    found = recheck.checks(store)
    newer = _store_newer(path)
    assert path.stem not in recheck.run(found, store, Limits(1, 60.0))
    assert path.read_text() == newer
    assert list(store.claims.iterdir()) == []


def test_a_summary_that_another_run_stores_meanwhile_is_not_written_over(store: Store) -> None:
    path = _edit(store, "ls", version=_only_summary)
    found = list(recheck._stamped(store))
    newer = _store_newer(path)
    assert recheck.summarise_anew(found, store) == 0
    assert path.read_text() == newer
    assert list(store.claims.iterdir()) == []


def test_a_cell_that_another_run_is_at_is_left_to_it(store: Store) -> None:
    path = _edit(store, "ls", version=_only_summary)
    before, other = path.read_text(), Claims(store.claims)
    assert other.take(path.stem)
    assert recheck.summarise_anew(list(recheck._stamped(store)), store) == 0
    assert path.read_text() == before
    other.release_all()
    assert recheck.summarise_anew(list(recheck._stamped(store)), store) == 1


def _absurd(store: Store) -> StoredCell:
    """A cell, by its own name, of a scenario over 10^14 s: nobody can compute its bound, in the memory of any run."""
    before = next(stored for stored in store if stored.cell["method"] == "ls")
    data = before.cell["data"]
    parameters = {**data["parameters"], "k3": 4.0}
    stated = {**before.cell, "data": {**data, "system": "duffing", "parameters": parameters, "duration": 1e14}}
    scenario = Scenario.from_dict(stated, label="duffing")
    cell = Cell(scenario, "ls", stated["settings"], stated["replicates"], stated["seed"], "ls")
    version = cell.version.as_json()
    stored = replace(before, identity=cell.identity, cell={**stated, **cell.stated()}, version=version)
    return store.save(stored)


@pytest.mark.parametrize("stale", ["rows", "summary"])
def test_a_cell_whose_bound_cannot_be_computed_within_the_limits_stays_stale_and_the_others_are_confirmed(
    stale: str, store: Store, capsys: pytest.CaptureFixture[str]
) -> None:
    """The bound is computed in a process that the run's limits end, not in the command's own."""
    absurd = _absurd(store)
    digest = OLD if stale == "rows" else f"{absurd.version['digest'].partition('-')[0]}-{OLD}"
    store.restate(replace(absurd, version={**absurd.version, "digest": digest}))
    other = _edit(store, "matrix_pencil", version=_older)
    kept = store.path(absurd.identity).read_bytes()
    assert recheck.main([f"store={store.folder}", "archive=none"]) == 0
    said = capsys.readouterr().out.replace("\n  ", " ").splitlines()  # a long sentence goes on in the next line
    (line,) = [text for text in said if text.startswith(absurd.identity[:8])]
    assert "ls on duffing, 20 dB: its bound cannot be computed: " in line
    assert line.endswith("it stays stale")
    assert "1 cells checked: 1 come out the same" in said[-1]
    assert store.path(absurd.identity).read_bytes() == kept
    assert _digest(other) != OLD
    assert list(store.claims.iterdir()) == []


def test_limits_are_the_widest_that_a_run_may_have(store: Store) -> None:
    (first, second) = store
    limits = {"timeout_s": 900.0, "memory_mb": 1e300}
    found = recheck.widest_limits([replace(first, provenance={"limits": limits}), replace(second, provenance={})], 3)
    assert (found.workers, found.timeout_s, found.memory_mb) == (3, 900.0, Limits().memory_mb)
    for absurd in (math.inf, math.nan, -1.0, 1e10):
        own = replace(first, provenance={"limits": {"timeout_s": absurd, "memory_mb": absurd}})
        assert recheck.widest_limits([own], 1).timeout_s == Limits().timeout_s
