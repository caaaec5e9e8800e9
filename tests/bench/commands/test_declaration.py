"""The fields of a verb, their errors, help and completion, from the parameters of its function."""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import pytest

from bench.commands.declaration import (
    OneOf,
    Others,
    Parsed,
    Within,
    command_line,
    completions,
    help_page,
    read_arguments,
    settings_of,
)
from bench.commands.main import main
from bench.commands.verbs import VERBS, completed, variants
from bench.config.declaration import fields_of
from bench.errors import InputError


def even(text: str) -> int:
    """Read an even number."""
    if int(text) % 2:
        raise ValueError("an even number")
    return int(text)


def measure(
    data: Annotated[str, "measured record"],
    record: Annotated[Sequence[str], Others(("columns", "system")), "columns=, system="],
    count: Annotated[int, Within(ge=0, le=100), "number of repeats"] = 20,
    level: Annotated[float, Within(gt=0, le=10), "a level"] = 0.5,
    mode: Annotated[Literal["fast", "slow"], "how"] = "fast",
    method: Annotated[tuple[str, ...], OneOf(("ls", "rls", "shooting")), "methods"] = ("ls",),
    dry: Annotated[bool, "no work"] = False,
    from_: Annotated[float | None, "start (s)"] = None,
    out: Annotated[Path, "folder to write"] = Path("here"),
    pair: Annotated[int, Parsed(even), "a pair"] = 2,
) -> int:
    """Measure something.

    Details.
    """
    return 0


def test_words_become_values_of_the_declared_types() -> None:
    words = ["data=a,b.csv", "count=3", "level=1e-3", "mode=slow", "method=rls,ls", "dry=true", "from=-1", "out=~/x"]
    values = read_arguments(measure, [*words, "pair=4", "system.n=2", "columns=t:0"])
    assert values == {
        "data": "a,b.csv", "count": 3, "level": 1e-3, "mode": "slow", "method": ("rls", "ls"), "dry": True,
        "from_": -1.0, "out": Path.home() / "x", "pair": 4, "record": ["system.n=2", "columns=t:0"],
    }  # fmt: skip
    assert read_arguments(measure, ["data=x"]) == {"data": "x", "record": []}  # all others have defaults


@pytest.mark.parametrize(
    ("word", "message"),
    [
        ("cuont=3", "cuont=3: not a field; did you mean count?"),
        ("count=", "count=: give a value, or leave the field out"),
        ("clean.csv", "argument=clean.csv: write data=clean.csv"),
        ("slow", "argument=slow: write mode=slow"),
        ("--count", "argument=--count: write count=<value>"),
        ("-x", "argument=-x: options are --help, --version, -v and -q"),
        ("data=y", "data=y: given twice"),
        ("mode=fsat", "mode=fsat: did you mean fast? one of fast, slow"),
        ("method=ls,rsl", "method=rsl: did you mean rls? one of ls, rls, shooting"),
        ("method=ls,ls", "method=ls,ls: write names separated by commas, each once"),
        ("method=ls,", "method=ls,: write names separated"),
        ("dry=maybe", "dry=maybe: input should be a valid boolean"),
        ("from=nan", "from=nan: input should be a finite number"),
        ("from=1e999", "from=1e999: input should be a finite number"),
        ("count=2.5", "count=2.5: input should be a valid integer"),
        ("count=101", "count=101: input should be less than or equal to 100"),
        ("level=0", "level=0: input should be greater than 0"),
        ("pair=3", "pair=3: an even number"),
    ],
)
def test_a_wrong_word_is_named_with_a_remedy(word: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        read_arguments(measure, ["data=x", word])
    assert str(caught.value).startswith(message)


def test_a_missing_required_field_is_named() -> None:
    with pytest.raises(InputError, match="data=: needed: measured record"):
        read_arguments(measure, ["count=3"])


def test_settings_are_read_by_the_grammar_of_a_run() -> None:
    words = ["method.width=32", "method.rate=1e-3", "system.n=[1,2]", "method.kind=word"]
    assert settings_of(words) == {"method": {"width": 32, "rate": 1e-3, "kind": "word"}, "system": {"n": [1, 2]}}
    for wrong in ("method.=3", "method.x={", "method=ls", "method.x=1,2"):
        with pytest.raises(InputError):
            settings_of([wrong])


def test_the_help_lists_every_field_with_default_and_choices() -> None:
    lines = help_page("python -m bench measure", measure).splitlines()
    assert lines[0] == "usage: python -m bench measure data=<value> [field=value ...]"
    assert lines[2] == "Measure something."
    shown = {line.split()[0]: line for line in lines if line.startswith("  ")}
    assert set(shown) == {"data", "count", "level", "mode", "method", "dry", "from", "out", "pair", "..."}
    assert "[20] number of repeats" in shown["count"]
    assert "[fast] how; fast, slow" in shown["mode"]


@pytest.mark.parametrize(
    ("word", "offered"),
    [("co", ["count="]), ("mode=", ["mode=fast", "mode=slow"]), ("dry=t", ["dry=true"]), ("nothing=", [])],
)
def test_the_shell_completes_fields_and_their_values(word: str, offered: list[str]) -> None:
    assert completions(measure, word) == offered


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("python -m bench ce", ["certify"]),
        ("vibration-bench tables what=f", ["what=frame", "what=figures"]),
        ("vibration-bench share action=export form=ar", ["form=arviz"]),
        ("vibration-bench tables what=figures sv", ["svg="]),
        ("vibration-bench method=sh", []),
    ],
)
def test_the_shell_completes_verbs(line: str, offered: list[str]) -> None:
    assert completed(line) == offered


def test_a_command_line_leaves_out_defaults() -> None:
    bound = inspect.signature(measure).bind("a b.csv", ["system.n=2"], count=3)
    bound.apply_defaults()
    assert command_line(measure, bound.arguments) == "python -m bench measure 'data=a b.csv' system.n=2 count=3"


@pytest.mark.parametrize("name", VERBS)
def test_every_verb_and_field_has_a_description(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    for verb in variants(name).values():
        assert (inspect.getdoc(verb) or "").split("\n")[0].endswith((".", ";"))
        assert all(field.text for field in fields_of(verb).values())
    assert main([name, "--help"]) == main([name, "--version"]) == 0
    out = capsys.readouterr().out
    assert out.startswith(f"usage: python -m bench {name}")
    assert out.count("usage: ") >= len(set(variants(name).values()))
    assert max(map(len, out.splitlines())) <= 80
