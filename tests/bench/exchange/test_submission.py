"""A submission is verified by running rows of it again; two stores merge and nothing is lost."""

from __future__ import annotations

import json
import math
import os
import shutil
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import Python, damaged, install
from stored import described, recorded, save, scored

from bench.commands.main import main
from bench.config.experiment import expand
from bench.contract.estimate import Status
from bench.engine.launch import complete
from bench.engine.pool import Limits
from bench.entrants.registry import load_method
from bench.errors import InputError
from bench.exchange import merging
from bench.exchange.merging import draw
from bench.exchange.submission import MANIFEST, pack, unpack
from bench.scenario.scenario import Scenario
from bench.scoring.row import Row
from bench.store.cell import Cell, stored_as_cell
from bench.store.store import Store
from bench.store.stored_cell import StoredCell

N = 12
TODAY = load_method("ls").version
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


NAME = "k_over_m_error_pct"


def as_it_is(stored: StoredCell) -> StoredCell:
    return stored


def better_numbers(stored: StoredCell) -> StoredCell:
    """All errors of k/m halved."""
    return replace(
        stored,
        rows=tuple(replace(row, scores={**row.scores, NAME: row.scores[NAME] / 2}) for row in stored.rows),
    )


def embellished(stored: StoredCell) -> StoredCell:
    """A small median in the summary alone; other packages; computed within limits that are none."""
    limits = {"timeout_s": math.inf, "memory_mb": 1e300, "workers": math.nan}
    packages = {**stored.provenance["packages"], "numpy": "1.0"}
    summary = {**stored.summary, NAME: {**stored.summary[NAME], "median": 1e-3}}
    return replace(stored, summary=summary, provenance={**stored.provenance, "limits": limits, "packages": packages})


def other_code(stored: StoredCell) -> StoredCell:
    return replace(stored, version={**stored.version, "method": 99})


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
    return replace(
        stored, identity=cell.identity, cell={**changed, **cell.full_description()}, version=cell.version.as_json()
    )


def fewer_rows(stored: StoredCell) -> StoredCell:
    return replace(stored, rows=tuple(stored.rows)[:-3])


# ---- the file


def test_a_name_that_leads_out_of_the_file_is_refused(computed: Store, tmp_path: Path) -> None:
    path = submission(computed, tmp_path / "ls.submission")
    with zipfile.ZipFile(path) as archive:
        contents = {name: archive.read(name) for name in archive.namelist()}
    manifest = json.loads(contents.pop(MANIFEST))
    manifest["cells"].append({"identity": "../../outside"})
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in contents.items():
            archive.writestr(name, content)
        archive.writestr("rows/../../outside.json", content)
        archive.writestr(MANIFEST, json.dumps(manifest))
    with pytest.raises(InputError, match="not a whole submission"):
        unpack(path)
    assert [item.name for item in tmp_path.iterdir()] == ["ls.submission"]


def test_a_flipped_bit_anywhere_is_refused_or_changes_nothing(computed: Store, tmp_path: Path) -> None:
    """Dates and rights of a file in a zip are of no account; all else has a checksum, or is one."""
    path = submission(computed, tmp_path / "ls.submission")
    manifest, kept = unpack(path)
    refused = 0
    for _ in damaged([path], 300):
        try:
            found, theirs = unpack(path)
        except InputError:
            refused += 1
            continue
        assert found == manifest
        assert all(same(one, two) for one, two in zip(theirs, kept, strict=True))
    assert refused > 200


# ---- which rows


def pairs(n_cells: int, n: int, status: Status = Status.OK) -> list[tuple[StoredCell, Cell]]:
    rows = tuple(Row(i, status) for i in range(n))
    return [(StoredCell(f"{i:020x}", {}, rows, {}, {}, {}, 0.0), None) for i in range(n_cells)]  # type: ignore[misc]


@pytest.mark.parametrize(("n_cells", "n", "share", "expected"), [(10, 100, 0.1, 100), (1, 12, 0.1, 5), (1, 3, 1.0, 3)])
def test_a_tenth_is_drawn_and_five_at_least_but_none_that_hangs_on_the_machine(
    n_cells: int, n: int, share: float, expected: int
) -> None:
    assert sum(map(len, draw(pairs(n_cells, n), share, 0).values())) == expected
    assert draw(pairs(n_cells, n, Status.TIMEOUT), share, 0) == {}


def test_every_row_is_drawn_as_often_as_any_other_and_nobody_can_know_which() -> None:
    """400 draws of 10 of 100 rows: each is met 40 times, with a standard deviation of 6."""
    met = np.zeros((5, 20))
    for seed in range(400):
        for identity, replicates in draw(pairs(5, 20), 0.1, seed).items():
            met[int(identity, 16), list(replicates)] += 1
    assert met.sum() == 4000
    assert met.min() > 40 - 5 * 6
    assert met.max() < 40 + 5 * 6


# ---- merged

Merge = Callable[..., tuple[int, str]]


@pytest.fixture
def merge(into: Store, capsys: pytest.CaptureFixture[str]) -> Merge:
    """Merge a file or a folder into the empty store; returns the exit status, and all that was printed."""

    def run(source: Path, *words: str) -> tuple[int, str]:
        capsys.readouterr()
        fields = [f"submission={source}", f"store={into.folder}", "workers=1", "fresh=0"]
        end = main(["share", "action=merge", *fields, *words])
        return end, "".join(capsys.readouterr())

    return run


def test_a_submission_is_verified_added_and_marked(
    computed: Store, into: Store, tmp_path: Path, merge: Merge, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its summary is not believed; other packages are no hindrance; limits that no run takes do not widen any."""
    limits: list[Limits] = []
    run = merging.recompute
    monkeypatch.setattr(merging, "recompute", lambda chosen, given: (limits.append(given), run(chosen, given))[1])
    end, out = merge(submission(computed, tmp_path / "ls.submission", embellished))
    assert (end, "5 of 24 rows computed again, and all come out the same" in out) == (0, True)
    assert "2 cells added" in out
    assert [(own.timeout_s, own.memory_mb) for own in limits] == [(Limits().timeout_s, Limits().memory_mb)]
    for before, after in zip(of_method(computed), into, strict=True):
        assert after.cell == {**before.cell, "label": "ls (submitted)"}
        assert [row.scores for row in after.rows] == [row.scores for row in before.rows]
        assert after.summary[NAME]["median"] == pytest.approx(before.summary[NAME]["median"], rel=1e-4)
        assert after.provenance["packages"]["numpy"] == "1.0"
        facts = after.provenance["submitted"]
        assert (facts["by"], facts["rows_compared"], facts["of_rows"]) == ("somebody", 5, 24)
        # of 24 rows 2 are changed: C(22, 5) / C(24, 5)
        assert facts["missed_5_percent"] == pytest.approx(math.comb(22, 5) / math.comb(24, 5), rel=1e-4)
        assert stored_as_cell(after).identity == before.identity
        assert after.arrays.keys() == before.arrays.keys()
    assert sum(len(stored.provenance["submitted"]["replicates"]) for stored in into) == 5


def test_rows_made_better_are_found_and_nothing_is_added(
    computed: Store, into: Store, tmp_path: Path, merge: Merge
) -> None:
    end, out = merge(submission(computed, tmp_path / "ls.submission", better_numbers))
    assert (end, "come out otherwise" in out, "ls on sdof" in out) == (1, True, True)
    assert into.identities() == []


@pytest.mark.parametrize(
    ("change", "facts", "words"),
    [
        (other_code, {}, f"method version 99, today {TODAY}; install"),
        (fewer_rows, {}, "lacks some of its 12 rows"),
        (a_reference, {}, "is of oracle, the submission of ls"),
        (another_question, {}, "means nothing here: cell="),
        (absurd, {}, "the bound cannot be computed"),
        (as_it_is, {"class": "somebody.methods:LS"}, "by somebody.methods:LS, and ls is methods.regression.ls:LS here"),
    ],
)
def test_what_could_not_be_computed_again_is_bad_input(
    change: Change, facts: dict[str, str], words: str, computed: Store, into: Store, tmp_path: Path, merge: Merge
) -> None:
    end, error = merge(submission(computed, tmp_path / "ls.submission", change, **facts))
    assert (end, error.count("\n")) == (2, 1)
    assert words in error
    assert into.identities() == []


def test_ones_own_cell_is_not_replaced_by_a_submitted_one_but_replaces_it(
    computed: Store, into: Store, tmp_path: Path, merge: Merge
) -> None:
    path = submission(computed, tmp_path / "ls.submission")
    assert merge(path)[0] == 0
    assert "1 cells added, 2 in the place of others, 0 kept" in merge(computed.folder)[1]
    assert not any(stored.submitted for stored in into)
    assert "0 cells added, 0 in the place of others, 2 kept" in merge(path)[1]
    assert not any(stored.submitted for stored in into)


@pytest.mark.slow
@pytest.mark.parametrize(("method", "status", "words"), [("enumerate", 1, "they differ"), ("ls", 0, "they agree")])
def test_a_method_that_knows_public_data_is_found_on_fresh_ones(
    method: str, status: int, words: str, python: Python, tmp_path: Path
) -> None:
    """It makes public data again and answers with their truth, and so it does where rows are recomputed."""
    env = install(tmp_path / "site", "double", "[bench.methods]\nenumerate = misbehaving:Enumerate\n")
    env["PYTHONPATH"] += f"{os.pathsep}{Path(__file__).parents[2]}"

    def run(*fields: str) -> tuple[int, str]:
        done = python("-m", "bench", *fields, env=env)
        return done.returncode, " ".join(f"{done.stdout} {done.stderr}".split())

    assert run(f"method={method}", "replicates=12", "store=rows")[0] == 0
    assert run("share", "action=submit", f"method={method}", "store=rows")[0] == 0
    end, shown = run("share", "action=merge", f"submission={method}.submission", "store=into", "fresh=16")
    assert (end, words in shown) == (status, True), shown
    assert "5 of 12 rows computed again, and all come out the same" in shown
    assert "16 problems of a secret seed" in shown


def filled(folder: Path, *labels: str) -> Store:
    """A store of made-up cells with arrays and tracebacks."""
    store = Store(folder)
    store.prepare()
    for label in labels:
        rows = scored(label, 6)
        save(store, described(label, n=6), rows, recorded(rows, True, False), tracebacks=f"traceback of {label}")
    return store


def test_two_stores_merge_and_nothing_is_lost(into: Store, tmp_path: Path, merge: Merge) -> None:
    """Every cell, its rows, arrays and tracebacks."""
    stores = filled(tmp_path / "one", "a", "b"), filled(tmp_path / "other", "b", "c", "d")
    every = {stored.identity: stored for store in stores for stored in store}
    for store in stores:
        assert merge(store.folder)[0] == 0
    assert set(into.identities()) == every.keys()
    for stored in into:
        assert same(stored, every[stored.identity])
        assert stored.tracebacks == f"traceback of {stored.cell['label']}"
        assert stored.arrays["displacement"].shape == (1, 200)


def test_of_two_answers_the_present_codes_is_kept_and_then_the_one_with_more_fits(
    computed: Store, into: Store, tmp_path: Path, merge: Merge
) -> None:
    stale, short = (Store(tmp_path / name) for name in ("stale", "short"))
    first = of_method(computed)[0]
    failed = tuple(replace(row, status=Status.TIMEOUT) for row in first.rows)
    for store, stored in ((stale, other_code(first)), (short, replace(first, rows=failed))):
        store.prepare()
        store.save(stored)
    for source, version, n_ok in ((stale, 99, N), (short, TODAY, 0), (computed, TODAY, N), (stale, TODAY, N)):
        assert merge(source.folder)[0] == 0
        found = into.load(first.identity)
        assert found is not None
        assert (found.version["method"], found.n_ok) == (version, n_ok)


# ---- submitted


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder as the current one."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_cells_of_a_method_are_packed(computed: Store, here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of table 3, at 20 dB alone, with its 100 replicates or any other number: the scenario counts."""
    assert main(["share", "action=submit", "method=ls", f"store={computed.folder}", "by=a group"]) == 0
    assert "2 cells of ls, 24 rows" in capsys.readouterr().out
    manifest, theirs = unpack(here / "ls.submission")
    assert (manifest["method"], manifest["class"], manifest["by"]) == ("ls", "methods.regression.ls:LS", "a group")
    assert "open" in manifest["releases"]
    own = of_method(computed)
    assert [line["identity"] for line in manifest["cells"]] == [stored.identity for stored in own]
    assert [line["version"] for line in manifest["cells"]] == [stored.version for stored in own]
    assert all(line["seed"] == 0 and line["data"] for line in manifest["cells"])
    for before, after in zip(own, theirs, strict=True):
        assert same(before, after)
        assert before.arrays.keys() == after.arrays.keys() != set()
        for name, values in after.arrays.items():
            np.testing.assert_array_equal(values, before.arrays[name])
    assert main(["share", "action=submit", "method=ls", "experiment=table3", f"store={computed.folder}"]) == 0
    assert [line["snr_db"] for line in unpack(here / "ls.submission")[0]["cells"]] == [20.0]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["method=ls", "experiment=open"], "no cell of it of open in"),
        (["method=matrix_pencil"], "1 of 1 cells"),
    ],
)
def test_what_cannot_be_submitted_is_one_line_and_writes_nothing(
    arguments: list[str], words: str, computed: Store, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    store = Store(here / "rows")
    store.prepare()
    for stored in computed:
        store.save(other_code(stored) if stored.cell["method"] == "matrix_pencil" else stored)
    assert main(["share", "action=submit", *arguments, f"store={store.folder}"]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
    assert list(here.glob("*.submission")) == []
