"""A round is written, solved from its files alone, opened and verified; what was changed is noticed."""

from __future__ import annotations

import csv
import hashlib
import json
import math
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from conftest import REPOSITORY

from bench.commands.main import main
from bench.config.files import read_yaml
from bench.entrants.registry import make_method
from bench.errors import InputError
from bench.information.fisher import compute_bound
from bench.rounds import draw
from bench.rounds.draw import KINDS, draw_round
from bench.rounds.folder import COMMITMENT, OPENED, PROBLEMS, ROUND, TEMPLATE, TRUTH, read_secret
from bench.rounds.problem_file import equations, read_problem, short_name
from bench.rounds.solve import answer
from bench.scenario.scenario import Scenario
from bench.systems import make_system

EXAMPLE = REPOSITORY / "docs" / "how_to" / "round_scipy.py"


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture
def copied(six: tuple[Path, Path], tmp_path: Path) -> tuple[Path, Path]:
    """The round and its secret, to be changed."""
    return shutil.copytree(six[0], tmp_path / "six"), shutil.copytree(six[1], tmp_path / "secret")


def test_files_of_a_round_ask_for_each_quantity_once_and_every_kind_is_there(six: tuple[Path, Path]) -> None:
    folder, secret = six
    truth, template = rows(secret / TRUTH), rows(folder / TEMPLATE)
    asked = [(row["scenario"], row["quantity"]) for row in template]
    assert asked == [(row["scenario"], row["quantity"]) for row in truth]
    assert len(set(asked)) == len(asked)
    assert {row["kind"] for row in truth} == set(KINDS)
    assert all(0 < float(row["bound"]) <= 0.3 * float(row["value"]) for row in truth)
    by_problem = {name: {q for scenario, q in asked if scenario == name} for name, _ in asked}
    for name, quantities in by_problem.items():
        known = json.loads((folder / PROBLEMS / f"{name}.json").read_text())
        assert quantities == set(known["asked"])
        assert all(("/" in quantity or quantity in "l") == (known["force"] is None) for quantity in quantities)


def test_a_round_solved_through_files_is_the_one_solved_in_the_harness(six: tuple[Path, Path], tmp_path: Path) -> None:
    """Shooting on the drawn problems and on their files: the same estimates to a thousandth of the bound."""
    folder, secret = six
    out = tmp_path / "predictions.csv"
    assert main(["round", "solve", str(folder), "method=shooting", f"out={out}"]) == 0
    from_files = {(row["scenario"], row["quantity"]): row for row in rows(out)}
    method, compared = make_method("shooting", {}), 0
    seed = read_secret(folder, secret).seed
    for number, drawn in enumerate(draw_round(seed, 6, read_yaml("", "round"))):
        estimate = answer(method, drawn.problem, number)
        for quantity, (_, bound) in drawn.truth.items():
            row = from_files[drawn.name, short_name(quantity)]
            marginal = estimate.marginal(estimate.system.quantity(quantity))
            assert (marginal is None) == (row["value"] == "")
            if marginal is not None:
                low, high = marginal.interval(0.95)
                assert float(row["value"]) == pytest.approx(marginal.value, abs=1e-3 * bound)
                assert [float(row["low"]), float(row["high"])] == pytest.approx([low, high], abs=1e-2 * bound)
                compared += 1
    assert compared >= 10


def test_a_script_without_this_project_takes_part(six: tuple[Path, Path], tmp_path: Path) -> None:
    """The example of the guide, run where neither bench nor methods can be imported, answers the free decays."""
    for name in ("problems", TEMPLATE):
        source = six[0] / name
        shutil.copytree(source, tmp_path / name) if source.is_dir() else shutil.copy(source, tmp_path)
    block = "import sys; sys.modules['bench'] = sys.modules['methods'] = None; exec(open(sys.argv[1]).read())"
    subprocess.run([sys.executable, "-c", block, str(EXAMPLE)], cwd=tmp_path, check=True, timeout=120)
    answers, truth = rows(tmp_path / "predictions.csv"), rows(six[1] / TRUTH)
    assert [(row["scenario"], row["quantity"]) for row in answers] == [(r["scenario"], r["quantity"]) for r in truth]
    errors = []
    for row, true in zip(answers, truth, strict=True):
        known = json.loads((six[0] / PROBLEMS / f"{true['scenario']}.json").read_text())
        free = known["system"]["kind"] == "sdof" and known["force"] is None
        assert (row["value"] != "") == free
        if free and true["kind"] == "free decay":
            errors.append(abs(float(row["value"]) - float(true["value"])) / float(true["bound"]))
    assert errors
    assert max(errors) < 6


def test_the_commitment_can_be_computed_without_this_project(six: tuple[Path, Path]) -> None:
    folder, secret = six
    lines = [json.loads((secret / "secret.json").read_text())["seed"]]
    lines += [hashlib.sha256(path.read_bytes()).hexdigest() for path in (folder / ROUND, secret / TRUTH)]
    text = "".join(f"{line}\n" for line in lines)
    assert json.loads((folder / COMMITMENT).read_text())["commitment"] == hashlib.sha256(text.encode()).hexdigest()


@pytest.mark.slow
@pytest.mark.parametrize("folder", sorted((REPOSITORY / "results" / "rounds").glob("round_*")), ids=lambda p: p.name)
def test_a_published_round_is_that_of_its_seed(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["round", "verify", str(folder)]) == 0, capsys.readouterr().out


def test_an_opened_round_is_verified(copied: tuple[Path, Path], capsys: pytest.CaptureFixture[str]) -> None:
    folder, secret = copied
    (secret / "methods").mkdir()
    (secret / "methods" / "ls.csv").write_text("x")
    assert main(["round", "open", str(folder), f"secret={secret}"]) == 0
    assert (folder / "methods" / "ls.csv").exists()
    assert main(["round", "verify", str(folder)]) == 0
    assert "agree with the seed" in capsys.readouterr().out
    sample = folder / PROBLEMS / "P003.csv"
    lines = sample.read_text().splitlines()
    words = lines[5].split(",")
    lines[5] = ",".join([words[0], f"{float(words[1]) * 1.001:.7g}", *words[2:]])
    sample.write_text("\n".join([*lines, ""]))
    (folder / PROBLEMS / "P001.json").unlink()
    (folder / PROBLEMS / "P007.csv").write_text("t [s]\n")
    assert main(["round", "verify", str(folder)]) == 1
    assert capsys.readouterr().out.splitlines() == [
        "problems/P001.json is missing", "problems/P007.csv is no file of the round",
        "problems/P003.csv differs from what the seed gives",
    ]  # fmt: skip


Change = Callable[[Path, Path], object]


@pytest.mark.parametrize(("change", "start"), [
    (lambda folder, secret: (secret / TRUTH).write_text((secret / TRUTH).read_text().replace("1", "2")), "secret="),
    (lambda folder, secret: (secret / "secret.json").write_text(json.dumps({"seed": "0" * 64})), "secret="),
    (lambda folder, secret: (secret / "secret.json").unlink(), "secret="),
    (lambda folder, secret: (folder / ROUND).write_text((folder / ROUND).read_text().replace("30", "31")), "secret="),
    (lambda folder, secret: (folder / ROUND).unlink(), "round="),
    (lambda folder, secret: (folder / COMMITMENT).write_text("[]"), "round="),
    (lambda folder, secret: shutil.rmtree(secret), "secret="),
])  # fmt: skip
def test_a_secret_that_is_not_that_of_the_round_is_one_line(
    change: Change, start: str, copied: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    folder, secret = copied
    change(folder, secret)
    assert main(["round", "open", str(folder), f"secret={secret}"]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"bench: {start}")
    assert error.count("\n") == 1
    assert not (folder / OPENED).exists()


@pytest.mark.parametrize(("name", "change"), [
    ("P001.csv", lambda text: text.replace(",", ";")),
    ("P001.csv", lambda text: text.replace("t [s]", "time")),
    ("P001.csv", lambda text: ""),
    ("P001.json", lambda text: text[:-5]),
    ("P001.json", lambda text: text.replace('"kind"', '"sort"')),
    ("P001.json", lambda text: "[]"),
    ("P001.json", lambda text: text.replace('"asked": {', '"asked": 3, "before": {')),
])  # fmt: skip
def test_a_damaged_problem_is_named(name: str, change: Callable[[str], str], copied: tuple[Path, Path]) -> None:
    path = copied[0] / PROBLEMS / name
    path.write_text(change(path.read_text()))
    with pytest.raises(InputError, match="P001"):
        read_problem(copied[0] / PROBLEMS, "P001")


def test_equations_are_those_of_the_textbook() -> None:
    assert equations(make_system("sdof", {}), [0]) == ["c*x' - f + k*x + m*x'' = 0"]
    assert equations(make_system("chain", {"n": 2})) == [
        "c1*x1' - c2*(-x1' + x2') + k1*x1 - k2*(-x1 + x2) + m1*x1'' = 0",
        "c2*(-x1' + x2') + k2*(-x1 + x2) + m2*x2'' = 0",
    ]
    assert equations(make_system("duffing", {})) == ["c*x' + m*x'' + x*(k + k3*x^2) = 0"]


def test_a_round_is_not_written_over_another_nor_its_secret_into_it(
    six: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for out, secret, field in ((six[0], tmp_path / "s", "out"), (tmp_path / "r", six[1], "secret"),
                               (tmp_path / "r", tmp_path / "r" / "s", "secret")):  # fmt: skip
        assert main(["round", "new", "scenarios=1", f"out={out}", f"secret={secret}"]) == 2
        assert capsys.readouterr().err.startswith(f"bench: {field}=")
    assert list(tmp_path.iterdir()) == []


def test_a_bound_that_is_not_finite_determines_nothing(reference: Scenario, monkeypatch: pytest.MonkeyPatch) -> None:
    """As of a nonlinear motion that runs away."""
    bound = compute_bound(reference)
    unknown = replace(bound, relative_sd=dict.fromkeys(bound.relative_sd, math.nan))
    monkeypatch.setattr(draw, "compute_bound", lambda *_: unknown)
    with pytest.raises(InputError, match="determine"):
        draw.with_truth("P001", "free decay", reference, 2**200, 0.3)
