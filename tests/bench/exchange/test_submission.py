"""A submission is verified by running rows of it again; two stores merge and nothing is lost."""

from __future__ import annotations

import json
import math
import random
import secrets
import shutil
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from stored import described, recorded, save, scored

from bench.commands.main import main
from bench.config.experiment import expand
from bench.contract.estimate import Status
from bench.engine.launch import complete
from bench.engine.pool import Limits
from bench.errors import InputError
from bench.exchange import merging
from bench.exchange.merging import draw
from bench.exchange.submission import MANIFEST, pack, unpack
from bench.scenario.scenario import Scenario
from bench.scoring.path import MOMENTS, of_clock
from bench.scoring.row import Row
from bench.store.cell import Cell, stored_as_cell
from bench.store.store import Store
from bench.store.stored import StoredCell

N = 12
Change = Callable[[StoredCell], StoredCell]


@pytest.fixture(scope="module")
def computed(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """Two cells of one method and one of another; bounds beside them."""
    store = Store(tmp_path_factory.mktemp("computed") / "rows")
    store.prepare()
    cells = [
        job.cell()
        for words in (["method=ls", "snr=40,20"], ["method=matrix_pencil", "snr=20"])
        for job in expand([*words, f"replicates={N}"], multirun=True)
    ]
    complete(cells, store, Limits(1, 60.0))
    return store


@pytest.fixture
def into(computed: Store, tmp_path: Path) -> Store:
    """An empty store that knows the bounds."""
    store = Store(tmp_path / "into")
    store.prepare()
    shutil.copytree(computed.bounds, store.bounds)
    return store


def of_method(store: Store, method: str = "ls") -> list[StoredCell]:
    return [stored for stored in store if stored.cell["method"] == method]


def submission(computed: Store, path: Path, change: Change = lambda stored: stored, **facts: str) -> Path:
    """A file of the cells of a method, each changed."""
    pack(path, [change(stored) for stored in of_method(computed)], {"method": "ls", "by": "somebody", **facts})
    return path


def same(one: StoredCell, other: StoredCell) -> bool:
    """Equality in all but the arrays, NaN taken for NaN."""
    return repr(replace(one, rows=tuple(one.rows))) == repr(replace(other, rows=tuple(other.rows)))


def better_numbers(stored: StoredCell) -> StoredCell:
    """All errors of k/m halved, in rows and summary."""
    name = "k_over_m_error_pct"
    rows = tuple(replace(row, scores={**row.scores, name: row.scores[name] / 2}) for row in stored.rows)
    halved = {key: value / 2 for key, value in stored.summary[name].items()}
    return replace(stored, rows=rows, summary={**stored.summary, name: halved})


def better_summary(stored: StoredCell) -> StoredCell:
    """As if the median error were a tenth, in the summary alone."""
    name = "k_over_m_error_pct"
    return replace(stored, summary={**stored.summary, name: {**stored.summary[name], "median": 1e-3}})


def other_code(stored: StoredCell) -> StoredCell:
    return replace(stored, version={**stored.version, "method": 2})


def other_packages(stored: StoredCell) -> StoredCell:
    packages = {**stored.provenance["packages"], "numpy": "1.0"}
    return replace(stored, provenance={**stored.provenance, "packages": packages})


def endless(stored: StoredCell) -> StoredCell:
    """Computed, it says, within limits that are none."""
    limits = {"timeout_s": math.inf, "memory_mb": 1e300, "workers": math.nan}
    return replace(stored, provenance={**stored.provenance, "limits": limits})


def a_reference(stored: StoredCell) -> StoredCell:
    return replace(stored, cell={**stored.cell, "method": "oracle", "settings": {}})


def another_question(stored: StoredCell) -> StoredCell:
    """The rows of one seed as the answer to another."""
    return replace(stored, cell={**stored.cell, "seed": 7})


def absurd(stored: StoredCell) -> StoredCell:
    """A scenario over 10^14 s, by its own name: nobody can compute its bound."""
    data = {**stored.cell["data"], "duration": 1e14, "system": "duffing",
            "parameters": {**stored.cell["data"]["parameters"], "k3": 4.0}}  # fmt: skip
    changed = {**stored.cell, "data": data, "snr_db": data["snr_db"]}
    scenario = Scenario.from_dict(changed, label=changed["system"])
    cell = Cell(scenario, changed["method"], changed["settings"], changed["replicates"], changed["seed"], "ls")
    return replace(stored, identity=cell.identity, cell={**changed, **cell.stated()}, version=cell.version.as_json())


def fewer_rows(stored: StoredCell) -> StoredCell:
    return replace(stored, rows=tuple(stored.rows)[:-3])


# ---- the file


def test_what_is_packed_comes_back_as_it_was(computed: Store, tmp_path: Path) -> None:
    manifest, theirs = unpack(submission(computed, tmp_path / "ls.submission"))
    own = of_method(computed)
    assert [line["identity"] for line in manifest["cells"]] == [stored.identity for stored in own]
    assert [line["version"] for line in manifest["cells"]] == [stored.version for stored in own]
    assert all(line["seed"] == 0 and line["data"] for line in manifest["cells"])
    for before, after in zip(own, theirs, strict=True):
        assert same(before, after)
        assert before.arrays.keys() == after.arrays.keys() != set()
        for name, values in after.arrays.items():
            np.testing.assert_array_equal(values, before.arrays[name])


def _flip(contents: dict[str, bytes]) -> None:
    name = next(name for name in contents if name != MANIFEST)
    contents[name] = contents[name][:-1] + bytes([contents[name][-1] ^ 1])


def _lose(contents: dict[str, bytes]) -> None:
    del contents[next(name for name in contents if name != MANIFEST)]


def _escape(contents: dict[str, bytes]) -> None:
    manifest = json.loads(contents[MANIFEST])
    manifest["cells"].append({"identity": "../../outside"})
    contents["rows/../../outside.json"] = next(content for name, content in contents.items() if name != MANIFEST)
    contents[MANIFEST] = json.dumps(manifest).encode()


def _later_format(contents: dict[str, bytes]) -> None:
    contents[MANIFEST] = json.dumps({**json.loads(contents[MANIFEST]), "format": 99}).encode()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (_flip, "not a whole submission"),
        (_lose, "not a whole submission"),
        (_escape, "not a whole submission"),
        (_later_format, "of format 99"),
        (lambda contents: contents.pop(MANIFEST), "not a whole submission"),
    ],
)
def test_a_damaged_file_is_refused(
    change: Callable[[dict[str, bytes]], None], words: str, computed: Store, tmp_path: Path
) -> None:
    path = submission(computed, tmp_path / "ls.submission")
    with zipfile.ZipFile(path) as archive:
        contents = {name: archive.read(name) for name in archive.namelist()}
    change(contents)
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in contents.items():
            archive.writestr(name, content)
    with pytest.raises(InputError, match=words):
        unpack(path)
    assert [item.name for item in tmp_path.iterdir()] == ["ls.submission"]


def test_a_flipped_bit_anywhere_is_refused_or_changes_nothing(computed: Store, tmp_path: Path) -> None:
    """Dates and rights of a file in a zip are of no account; all else has a checksum, or is one."""
    path = submission(computed, tmp_path / "ls.submission")
    whole, seed = path.read_bytes(), secrets.randbits(32)
    print(f"seed {seed}")
    rng = random.Random(seed)
    manifest, kept = unpack(path)
    refused = 0
    for i in range(300):
        at, bit = rng.randrange(len(whole)), rng.randrange(8)
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 1 << bit]) + whole[at + 1 :] if i % 5 else whole[:at])
        try:
            found, theirs = unpack(path)
        except InputError:
            refused += 1
            continue
        assert found == manifest, (at, bit)
        assert all(same(one, two) for one, two in zip(theirs, kept, strict=True)), (at, bit)
    assert refused > 200


# ---- which rows


def pairs(n_cells: int, n: int, status: Status = Status.OK) -> list[tuple[StoredCell, Cell]]:
    rows = tuple(Row(i, status) for i in range(n))
    return [(StoredCell(f"{i:020x}", {}, rows, {}, {}, {}, 0.0), None) for i in range(n_cells)]  # type: ignore[misc]


@pytest.mark.parametrize(("n_cells", "n", "share", "expected"), [(10, 100, 0.1, 100), (1, 12, 0.1, 5), (1, 3, 1.0, 3)])
def test_a_tenth_is_drawn_and_five_at_least(n_cells: int, n: int, share: float, expected: int) -> None:
    assert sum(map(len, draw(pairs(n_cells, n), share, 0).values())) == expected


def test_every_row_is_drawn_as_often_as_any_other_and_nobody_can_know_which() -> None:
    """400 draws of 10 of 100 rows: each is met 40 times, with a standard deviation of 6."""
    met = np.zeros((5, 20))
    for seed in range(400):
        for identity, replicates in draw(pairs(5, 20), 0.1, seed).items():
            met[int(identity, 16), list(replicates)] += 1
    assert met.sum() == 4000
    assert met.min() > 40 - 5 * 6
    assert met.max() < 40 + 5 * 6


def test_rows_that_hang_on_the_machine_are_not_compared() -> None:
    assert draw(pairs(2, 20, Status.TIMEOUT), 0.1, 0) == {}


def test_scores_of_the_clock_are_known_by_their_names() -> None:
    timed = ["training_s", "arrival_s", *(f"k_over_m_off_pct_at_{moment:g}s" for moment in MOMENTS)]
    assert all(map(of_clock, timed))
    assert not any(map(of_clock, ("rmse", "k_over_m_off_pct_at_minimum", "k_over_m_error_pct", "starts_at_best")))


# ---- merged


def test_a_submission_is_verified_added_and_marked(
    computed: Store, into: Store, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = submission(computed, tmp_path / "ls.submission")
    assert main(["share", "action=merge", f"submission={path}", f"store={into.folder}", "workers=1"]) == 0
    out = capsys.readouterr().out
    assert "5 of 24 rows computed again, and all come out the same" in out
    assert "2 cells added" in out
    for before, after in zip(of_method(computed), into, strict=True):
        assert after.cell == {**before.cell, "label": "ls (submitted)"}
        assert [row.scores for row in after.rows] == [row.scores for row in before.rows]
        facts = after.provenance["submitted"]
        assert (facts["by"], facts["rows_compared"], facts["of_rows"]) == ("somebody", 5, 24)
        # of 24 rows 2 are changed: C(22, 5) / C(24, 5)
        assert facts["missed_5_percent"] == pytest.approx(math.comb(22, 5) / math.comb(24, 5), rel=1e-4)
        assert stored_as_cell(after).identity == before.identity
        assert after.arrays.keys() == before.arrays.keys()
    assert sum(len(stored.provenance["submitted"]["replicates"]) for stored in into) == 5


def test_rows_made_better_are_found_and_nothing_is_added(
    computed: Store, into: Store, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = submission(computed, tmp_path / "ls.submission", better_numbers)
    assert main(["share", "action=merge", f"submission={path}", f"store={into.folder}", "workers=1"]) == 1
    out = capsys.readouterr().out
    assert "come out otherwise" in out
    assert "ls on sdof" in out
    assert into.identities() == []


def test_a_summary_is_not_believed(computed: Store, into: Store, tmp_path: Path) -> None:
    path = submission(computed, tmp_path / "ls.submission", better_summary)
    assert main(["share", "action=merge", f"submission={path}", f"store={into.folder}", "workers=1"]) == 0
    name = "k_over_m_error_pct"
    for before, after in zip(of_method(computed), into, strict=True):
        assert after.summary[name]["median"] == pytest.approx(before.summary[name]["median"], rel=1e-4)


def test_other_packages_are_no_hindrance_where_the_numbers_are_the_same(
    computed: Store, into: Store, tmp_path: Path
) -> None:
    path = submission(computed, tmp_path / "ls.submission", other_packages)
    assert main(["share", "action=merge", f"submission={path}", f"store={into.folder}", "workers=1"]) == 0
    assert {stored.provenance["packages"]["numpy"] for stored in into} == {"1.0"}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (other_code, "method version 2, today 1; install"),
        (fewer_rows, "lacks some of its 12 rows"),
        (a_reference, "is of oracle, the submission of ls"),
        (another_question, "means nothing here: cell="),
    ],
)
def test_what_could_not_be_computed_again_is_bad_input(
    change: Change, words: str, computed: Store, into: Store, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = submission(computed, tmp_path / "ls.submission", change)
    assert main(["share", "action=merge", f"submission={path}", f"store={into.folder}"]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
    assert into.identities() == []


def test_a_submission_of_another_class_of_that_name_is_bad_input(
    computed: Store, into: Store, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = submission(computed, tmp_path / "ls.submission", **{"class": "somebody.methods:LS"})
    assert main(["share", "action=merge", f"submission={path}", f"store={into.folder}"]) == 2
    error = capsys.readouterr().err
    assert "was computed by somebody.methods:LS, and ls is methods.regression.ls:LS here" in error
    assert error.count("\n") == 1
    assert into.identities() == []


def test_limits_that_no_run_takes_do_not_widen_those_of_the_verification(
    computed: Store, into: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Limits] = []
    run = merging.recompute

    def noted(chosen: Any, limits: Limits) -> Any:
        asked.append(limits)
        return run(chosen, limits)

    monkeypatch.setattr(merging, "recompute", noted)
    path = submission(computed, tmp_path / "ls.submission", endless)
    assert main(["share", "action=merge", f"submission={path}", f"store={into.folder}", "workers=1"]) == 0
    assert [(one.timeout_s, one.memory_mb) for one in asked] == [(Limits().timeout_s, Limits().memory_mb)]


def test_a_bound_that_cannot_be_computed_within_the_limits_is_bad_input(
    computed: Store, into: Store, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In a process of its own: this one has no memory for it either."""
    one = of_method(computed)[0]
    path = tmp_path / "ls.submission"
    pack(path, [absurd(one)], {"method": "ls"})
    assert main(["share", "action=merge", f"submission={path}", f"store={into.folder}", "workers=1"]) == 2
    error = capsys.readouterr().err
    assert "its bound cannot be computed" in error
    assert error.count("\n") == 1
    assert into.identities() == []


def test_ones_own_cell_is_not_replaced_by_a_submitted_one_but_replaces_it(
    computed: Store, into: Store, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = submission(computed, tmp_path / "ls.submission")
    assert main(["share", "action=merge", f"submission={path}", f"store={into.folder}", "workers=1"]) == 0
    assert main(["share", "action=merge", f"submission={computed.folder}", f"store={into.folder}"]) == 0
    assert "1 cells added, 2 in the place of others, 0 kept" in capsys.readouterr().out
    assert not any(stored.submitted for stored in into)
    assert main(["share", "action=merge", f"submission={path}", f"store={into.folder}", "workers=1"]) == 0
    assert "0 cells added, 0 in the place of others, 2 kept" in capsys.readouterr().out
    assert not any(stored.submitted for stored in into)


def filled(folder: Path, *labels: str) -> Store:
    """A store of made-up cells, some with arrays and tracebacks."""
    store = Store(folder)
    store.prepare()
    for label in labels:
        rows = scored(label, 6)
        save(store, described(label, n=6), rows, recorded(rows, True, False), tracebacks=f"traceback of {label}")
    return store


@pytest.mark.parametrize("turned", [False, True])
def test_two_stores_merge_and_nothing_is_lost(turned: bool, tmp_path: Path) -> None:
    """Whichever is merged into the other: every cell, its rows, arrays and tracebacks."""
    one, other = filled(tmp_path / "one", "a", "b"), filled(tmp_path / "other", "b", "c", "d")
    every = {stored.identity: stored for store in (one, other) for stored in store}
    source, target = (one, other) if turned else (other, one)
    assert main(["share", "action=merge", f"submission={source.folder}", f"store={target.folder}"]) == 0
    assert set(target.identities()) == every.keys()
    for stored in target:
        assert same(stored, every[stored.identity])
        assert stored.tracebacks == f"traceback of {stored.cell['label']}"
        assert stored.arrays["displacement"].shape == (1, 200)


def test_of_two_answers_the_present_codes_is_kept_and_then_the_one_with_more_fits(
    computed: Store, tmp_path: Path
) -> None:
    stale, short, into = (Store(tmp_path / name) for name in ("stale", "short", "into"))
    first = of_method(computed)[0]
    for store, stored in (
        (stale, replace(first, version={**first.version, "method": 0})),
        (short, replace(first, rows=tuple(replace(row, status=Status.TIMEOUT) for row in first.rows))),
    ):
        store.prepare()
        store.save(stored)
    for source, expected in ((stale, 0), (short, 1), (computed, 1)):
        assert main(["share", "action=merge", f"submission={source.folder}", f"store={into.folder}"]) == 0
        found = into.load(first.identity)
        assert found is not None
        assert found.version["method"] == expected
    assert found.n_ok == N
    assert main(["share", "action=merge", f"submission={stale.folder}", f"store={into.folder}"]) == 0
    assert into.load(first.identity) is not None
    assert same(found, next(stored for stored in into if stored.identity == first.identity))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "submission=: needed"),
        (["submission=nowhere.submission"], "file not found"),
        (["submission=."], "no cell is stored there"),
        (["submission=nowhere", "verify=0.01"], "verify=0.01: input should be greater than or equal to 0.1"),
        (["submission=.", "store=."], "not merged with itself"),
    ],
)
def test_bad_input_to_merge_is_one_line(
    arguments: list[str],
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["share", "action=merge", *arguments]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1


# ---- submitted


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder as the current one."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_cells_of_a_method_are_packed(computed: Store, here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["share", "action=submit", "method=ls", f"store={computed.folder}", "by=a group"]) == 0
    assert "2 cells of ls, 24 rows" in capsys.readouterr().out
    manifest, theirs = unpack(here / "ls.submission")
    assert (manifest["method"], manifest["class"], manifest["by"]) == ("ls", "methods.regression.ls:LS", "a group")
    assert "open" in manifest["releases"]
    assert len(theirs) == 2


def test_only_the_cells_of_an_experiment_are_packed(computed: Store, here: Path) -> None:
    """Table 3 has 20 dB alone, and 100 replicates: the scenario counts, not how often it was drawn."""
    assert main(["share", "action=submit", "method=ls", "experiment=table3", f"store={computed.folder}"]) == 0
    manifest, _ = unpack(here / "ls.submission")
    assert [line["snr_db"] for line in manifest["cells"]] == [20.0]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["method=nobody"], "method=nobody: one of"),
        (["method=oracle"], "method=oracle: one of"),
        (["method=ekf"], "holds no cell of it"),
        (["method=ls", "experiment=open"], "holds no cell of it of open"),
        (["name=ls"], "name=ls: not a field"),
    ],
)
def test_bad_input_to_submit_is_one_line_and_writes_nothing(
    arguments: list[str], words: str, computed: Store, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["share", "action=submit", *arguments, f"store={computed.folder}"]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
    assert list(here.glob("*.submission")) == []


def test_stale_cells_are_not_submitted(computed: Store, here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    store = Store(here / "stale")
    store.prepare()
    for stored in of_method(computed):
        store.save(replace(stored, version={**stored.version, "method": 0}))
    assert main(["share", "action=submit", "method=ls", f"store={store.folder}"]) == 2
    assert "2 of 2 cells" in capsys.readouterr().err
