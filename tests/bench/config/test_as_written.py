"""What a command line says is taken as written: paths of any letters, lists and dictionaries, files of one's own."""

from __future__ import annotations

from pathlib import Path

import pytest

from bench.config.experiment import expand
from bench.config.overrides import read_overrides
from bench.errors import InputError, line_of, shortened

OWN = """label: own
kind: sdof
options: {}
parameters: {m: 2.0, c: 0.4, k: 8.0}
initial: {displacement: [1.0], velocity: [0.0]}
duration: 10.0
samples: 25
force: null
"""


@pytest.mark.parametrize(
    "path", ["größe.csv", "a=b.csv", "two words.csv", "back\\slash.csv", "a(1).csv", "x,y.csv", "'"]
)
def test_a_path_may_hold_any_letter(path: str) -> None:
    assert read_overrides([f"data={path}"]) == {"data": [path]}


def test_quotes_around_a_path_are_not_of_it_and_a_tilde_is_the_home_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/home/somebody")
    assert read_overrides(["store='a b'"]) == {"store": ["a b"]}
    assert read_overrides(["store=~/rows"]) == {"store": ["/home/somebody/rows"]}
    assert read_overrides(["archive=null"]) == {"archive": [None]}


@pytest.mark.parametrize(
    ("argument", "expected"),
    [
        ("system.parameters={m:1,c:0.5,k:9}", {"m": 1.0, "c": 0.5, "k": 9.0}),
        ("system.parameters.k=9", {"m": 1.0, "c": 0.4, "k": 9.0}),
    ],
)
def test_a_dictionary_may_be_given_whole_or_by_its_fields(argument: str, expected: dict[str, float]) -> None:
    assert dict(expand(["method=prior", argument], False)[0].scenario.parameters) == expected


def test_fields_that_a_file_leaves_out_can_be_set() -> None:
    scenario = expand(["method=prior", "system=chain2", "system.measured=[1]", "prior.draws=truth"], False)[0].scenario
    assert scenario.measured == (1,)
    assert scenario.prior is not None
    assert scenario.prior.draws == "truth"


def test_what_is_wrong_in_a_file_of_ones_own_is_said_by_its_own_name(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(OWN, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        expand(["method=prior", f"system={path}", "system.colour=red"], False)[0].cell()
    assert "file_" not in str(caught.value)


def test_a_long_value_is_cut_and_signs_are_written_out() -> None:
    line = line_of(InputError("field", f"\x1b[31m{'z' * 5000}\udcff", "short"))
    assert line.startswith("field=\\x1b[31mzzz")
    assert line.endswith("zzz\\udcff: short")
    assert len(line) < 300
    assert shortened("größe 梁") == "größe 梁"
