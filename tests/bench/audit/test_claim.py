"""Files of claims, well written and not: what is wrong is one line, before any work."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml

from bench.audit.claim import read_claim
from bench.audit.equation import expression
from bench.commands.main import main
from bench.errors import InputError

CLAIM = """
source: {authors: A. Author, year: 2026, title: A title, url: "https://example.org/claim"}
equation: "m*x'' + c*x' + k*x = 0"
parameters: {m: 1.0, c: 0.4, k: 8.0}
known: [m]
initial_state: {displacement: 1.0, velocity: 0.0, known: true}
times: {from: 0, to: 10, n: 25}
noise: {definition: standard deviation, value: 0.05}
given: {starting_value: {c: 1.0}}
readings: {initial state unknown: {initial_state: {known: false}}}
reported:
  - {method: network, quantity: c, value: 0.39}
  - {method: least squares, quantity: c, value: 0.42, sd: 0.03}
assumed: the noise is white
missing: more than one draw
"""
MALFORMED = {
    "empty": ("", "claim="),
    "no YAML": ("a: [", "claim="),
    "no source": (CLAIM.replace("source:", "from:"), "source"),
    "unknown field": (CLAIM.replace("known: [m]", "knwon: [m]"), "did you mean known"),
    "unknown field below": (CLAIM.replace("n: 25", "samples: 25"), "samples=25: not a field"),
    "decimal comma": (CLAIM.replace("value: 0.39}", "value: 0,39}"), "a decimal point"),
    "year": (CLAIM.replace("2026", "26"), "source.year=26"),
    "address": (CLAIM.replace("https://", "file:/"), "source.url="),
    "equation of nothing": (CLAIM.replace("m*x''", "m"), "it must contain x''"),
    "equation": (CLAIM.replace("k*x", "k*(x"), "equation="),
    "name in the equation": (CLAIM.replace("k*x =", "q*x ="), "q is unknown; known: x, x', x'', f"),
    "code in the equation": (CLAIM.replace("k*x =", "k*x.__class__ ="), "names, numbers"),
    "call in the equation": (CLAIM.replace("k*x =", "k(x) ="), "no value"),
    "name of the motion": (CLAIM.replace("c*x'", "f*x'").replace("c: ", "f: "), "parameters=f"),
    "parameter as text": (CLAIM.replace("m: 1.0", "m: one"), "parameters.m=one"),
    "zero": (CLAIM.replace("c: 0.4", "c: 0"), "parameters.c=0"),
    "nan": (CLAIM.replace("c: 0.4", "c: .nan"), "parameters.c=nan"),
    "unknown name known": (CLAIM.replace("known: [m]", "known: [mass]"), "known=mass"),
    "masses": (CLAIM.replace("displacement: 1.0", "displacement: [1, 2]"), "one per mass"),
    "at rest": (CLAIM.replace("displacement: 1.0", "displacement: 0"), "away from rest"),
    "times": (CLAIM.replace("to: 10", "to: -10"), "times="),
    "both": (CLAIM.replace("n: 25", "n: 25, step: 0.1"), "times="),
    "too many": (CLAIM.replace("n: 25", "step: 1.0e-9"), "times="),
    "generator": (CLAIM.replace("n: 25", "n: 25, drawn: os.system(1)"), "times.drawn="),
    "column": (CLAIM.replace("{from: 0, to: 10, n: 25}", "{column: t}"), "times.column=t"),
    "noise": (CLAIM.replace("standard deviation", "sd"), "noise.definition=sd"),
    "negative noise": (CLAIM.replace("value: 0.05", "value: -0.05"), "noise.value="),
    "force": (CLAIM + "force: sin(x)", "x is unknown"),
    "infinite force": (CLAIM + "force: 1/t", "not finite"),
    "measured": (CLAIM + "measured: y", "measured=y"),
    "data": (CLAIM + "data: {file: none.csv, time: t}", "data.file=none.csv"),
    "data elsewhere": (CLAIM + "data: {file: ../none.csv, time: t}", "data.file=../none.csv"),
    "infinite quantity": (CLAIM.replace("quantity: c", "quantity: 1/(c-0.4)"), "not inf"),
    "quantity": (CLAIM.replace("quantity: c", "quantity: zeta"), "zeta is unknown"),
    "quantity of nothing": (CLAIM.replace("quantity: c", "quantity: c-c"), "at the stated parameters"),
    "form": (CLAIM.replace("quantity: c,", "quantity: c, form: error,"), "reported.0.form=error"),
    "case": (CLAIM.replace("quantity: c,", "quantity: c, case: other,"), "reported.0.case=other"),
    "draws": (CLAIM.replace("quantity: c,", "quantity: c, draws: 0,"), "reported.0.draws=0"),
    "negative error": (CLAIM.replace("value: 0.39", "value: -1, form: percent error"), "not negative"),
    "field of a reading": (CLAIM.replace("{known: false}", "{knwon: false}"), "knwon=False: not a field"),
    "field of a case": (CLAIM + "cases: {b: {noise: {value: loud}}}", "cases.b.noise.value"),
    "start of a stranger": (CLAIM.replace("{c: 1.0}", "{q: 1.0}"), "given.starting_value=q"),
}


@pytest.mark.parametrize(("text", "said"), MALFORMED.values(), ids=MALFORMED)
def test_what_is_wrong_is_one_line(text: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "claim.yaml").write_text(text)
    assert main(["audit", str(tmp_path / "claim.yaml")]) == 2
    out, error = capsys.readouterr()
    assert out == ""
    assert error.count("\n") == 1
    assert said in error


@pytest.mark.parametrize(
    "text", ["9**9**9**9", "(9**99)**99", "__import__('os')", "m if m else m", "[m]", "m.real", "'m'"]
)
def test_an_expression_is_arithmetic_of_names(text: str) -> None:
    with pytest.raises(InputError):
        expression(text, ["m"], "quantity")


def test_sample_times() -> None:
    """By numpy's own generators, and the first points of Halton's sequence in base 2."""
    stated = {
        "{from: 0, to: 1, n: 5, drawn: default_rng(7)}": np.sort(np.random.default_rng(7).uniform(0, 1, 5)),
        "{from: 0, to: 1, n: 5, drawn: RandomState(7)}": np.sort(np.random.RandomState(7).uniform(0, 1, 5)),
        "{from: 0, to: 4, n: 4, drawn: halton}": [0, 1, 2, 3],
        "{from: 0, to: 1, step: 0.25}": [0, 0.25, 0.5, 0.75],
        "[3, 1, 2.5]": [1, 2.5, 3],
    }
    for text, times in stated.items():
        claim = read_claim("claim", yaml.safe_load(CLAIM.replace("{from: 0, to: 10, n: 25}", text)), Path())
        np.testing.assert_allclose(claim.situations["", ""].times, times)


def test_the_command_says_it_and_writes_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "mine.yaml").write_text(CLAIM)
    assert main(["audit", str(tmp_path / "mine.yaml"), f"out={tmp_path / 'out'}"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    for part in (
        "2 within", "one draw does not determine", "assumed: the noise is white", "missing: more than one draw",
        "the initial guess was", "times the bound", "other readings: the same, bound 0.0",
    ):  # fmt: skip
        assert part in said
    content = json.loads((tmp_path / "out" / "mine.json").read_text())
    assert [finding["verdict"] for finding in content["findings"]] == ["within"] * 4
    badge = ElementTree.fromstring((tmp_path / "out" / "mine.svg").read_text())
    assert "2 within" in str(badge.attrib["aria-label"])
    assert (
        (tmp_path / "out" / "mine.md").read_text().startswith("A. Author (2026), A title, https://example.org/claim.")
    )
    main(["audit", str(tmp_path / "mine.yaml"), "format=json"])
    assert json.loads(capsys.readouterr().out) == content
