"""A verb is a function: its fields, their errors, its help and what the shell completes follow from its parameters."""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import pytest

from bench.commands.declaration import (
    Choice,
    File,
    Number,
    Others,
    Whole,
    command_line,
    completions,
    fields_of,
    flag,
    folder,
    help_page,
    names_of,
    read_arguments,
    read_settings,
)
from bench.commands.main import main
from bench.commands.verbs import VERBS, completed, variants
from bench.errors import InputError


def measure(
    data: Annotated[str, "measured record"],
    record: Annotated[Sequence[str], Others(("columns", "system")), "columns=, system="],
    count: Annotated[int, Whole(0, 100), "number of repeats"] = 20,
    level: Annotated[float, Number(0.0, 10.0, "a positive number"), "a level"] = 0.5,
    mode: Annotated[Literal["fast", "slow"], "how"] = "fast",
    method: Annotated[tuple[str, ...], Choice(("ls", "rls", "shooting"), several=True), "methods"] = ("ls",),
    dry: Annotated[bool, "no work"] = False,
    from_: Annotated[float | None, Number(), "start (s)"] = None,
    out: Annotated[Path, "folder to write"] = Path("here"),
) -> int:
    """Measure something.

    With care.
    """
    return 0


def error(*words: str) -> str:
    with pytest.raises(InputError) as caught:
        read_arguments(measure, words)
    return str(caught.value)


def test_words_become_values_of_the_declared_types() -> None:
    words = ["data=a,b.csv", "count=3", "level=1e-3", "mode=slow", "method=rls,ls", "dry=true", "from=-1", "out=~/x"]
    values = read_arguments(measure, [*words, "system.n=2", "columns=t:0"])
    assert values == {
        "data": "a,b.csv", "count": 3, "level": 1e-3, "mode": "slow", "method": ("rls", "ls"), "dry": True,
        "from_": -1.0, "out": Path.home() / "x", "record": ["system.n=2", "columns=t:0"],
    }  # fmt: skip
    assert read_arguments(measure, ["data=x"]) == {"data": "x", "record": []}  # the others have their defaults


@pytest.mark.parametrize(
    ("word", "remedy"),
    [
        ("cuont=3", "cuont=3: not a field; did you mean count?"),
        ("count=", "count=: give a value, or leave the field out"),
        ("clean.csv", "argument=clean.csv: write data=clean.csv"),
        ("slow", "argument=slow: write mode=slow"),
        ("count", "argument=count: write count=<value>"),
        ("--count", "argument=--count: write count=<value>"),
        ("-x", "argument=-x: options are --help and --version"),
        ("data=y", "data=y: given twice"),
        ("mode=fsat", "mode=fsat: did you mean fast? fast or slow"),
        ("method=ls,rsl", "method=rsl: did you mean rls? one of ls, rls, shooting"),
        ("method=ls,ls", "method=ls,ls: every name once"),
        ("method=ls,", "method=ls,: one name, or several"),
        ("dry=yes", "dry=yes: true or false"),
        ("from=nan", "from=nan: a number"),
    ],
)
def test_a_word_that_makes_no_sense_is_named_with_what_would_be_right(word: str, remedy: str) -> None:
    assert remedy in error("data=x", word)


@pytest.mark.parametrize("text", ["abc", "2.5", "-1", "²", "1e3", "101", "9" * 5000])
def test_what_is_no_whole_number_within_limits_is_refused(text: str) -> None:
    assert "a whole number from 0 to 100" in error("data=x", f"count={text}")


@pytest.mark.parametrize("text", ["abc", "nan", "-inf", "1e999", "0x1F", "1,5", "true", "0", "-1", "11"])
def test_what_is_no_finite_number_within_limits_is_refused(text: str) -> None:
    assert "a positive number, at most 10" in error("data=x", f"level={text}")


def test_a_required_field_is_named_where_it_is_missing() -> None:
    assert error("count=3") == "data=: needed: measured record"


def test_files_and_folders_to_read_must_exist(tmp_path: Path) -> None:
    for read, text in ((File(), "nowhere"), (File(), str(tmp_path)), (folder, "nowhere"), (folder, __file__)):
        with pytest.raises(InputError, match="not"):
            read("place", text)
    assert File()("place", __file__) == Path(__file__)
    assert folder("place", str(tmp_path)) == tmp_path
    assert (flag("dry", "false"), names_of("method", "a, b")) == (False, ("a", "b"))


def test_settings_are_read_as_yaml_has_them_and_an_exponent_as_a_number() -> None:
    words = ["method.width=32", "method.rate=1e-3", "system.n=[1, 2]", "method.kind=word"]
    assert read_settings(words) == {"method": {"width": 32, "rate": 1e-3, "kind": "word"}, "system": {"n": [1, 2]}}
    for wrong in ("method.=3", "method.x={", "method.x="):
        with pytest.raises(InputError):
            read_settings([wrong])


def test_the_help_shows_every_field_with_its_default_and_its_values() -> None:
    lines = help_page("python -m bench measure", measure).splitlines()
    assert lines[0] == "usage: python -m bench measure data=<value> [field=value ...]"
    assert lines[2] == "Measure something."
    shown = {line.split()[0]: line for line in lines if line.startswith("  ")}
    assert set(shown) == {"data", "count", "level", "mode", "method", "dry", "from", "out", "..."}
    assert "[20] number of repeats" in shown["count"]
    assert "[fast] fast, slow; how" in shown["mode"]


@pytest.mark.parametrize(
    ("word", "offered"),
    [
        ("co", ["count="]),
        ("mode=", ["mode=fast", "mode=slow"]),
        ("dry=t", ["dry=true"]),
        ("nothing=", []),
    ],
)
def test_the_shell_completes_fields_and_their_values(word: str, offered: list[str]) -> None:
    assert completions(measure, word) == offered


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("python -m bench ce", ["certify"]),
        ("vibration-bench tables what=f", ["what=figures"]),
        ("vibration-bench share action=export form=ar", ["form=arviz"]),
        ("vibration-bench tables what=figures sv", ["svg="]),
        ("vibration-bench certify tw", ["twins="]),
        ("vibration-bench method=sh", []),
    ],
)
def test_the_shell_completes_verbs(line: str, offered: list[str]) -> None:
    assert completed(line) == offered


def test_a_command_line_says_what_is_no_default() -> None:
    bound = inspect.signature(measure).bind("a b.csv", ["system.n=2"], count=3)
    bound.apply_defaults()
    assert command_line(measure, bound.arguments) == "python -m bench measure 'data=a b.csv' system.n=2 count=3"


@pytest.mark.parametrize("name", VERBS)
def test_every_verb_has_a_line_a_description_and_texts_of_its_fields(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for verb in variants(name).values():
        description = inspect.getdoc(verb)
        assert description
        assert description.split("\n")[0].endswith((".", ";"))
        assert all(field.text for field in fields_of(verb))
    assert main([name, "--help"]) == 0
    assert capsys.readouterr().out.startswith(f"usage: python -m bench {name}")
    assert main([name, "--version"]) == 0
    assert capsys.readouterr().out == main_version(capsys)


def main_version(capsys: pytest.CaptureFixture[str]) -> str:
    assert main(["--version"]) == 0
    return capsys.readouterr().out


@pytest.mark.parametrize("word", ["run", "identify"])
def test_a_run_may_be_called_by_its_name(word: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([word, "method=ls", "data=nowhere.csv"]) == main(["method=ls", "data=nowhere.csv"]) == 2
    first, second = capsys.readouterr().err.splitlines()
    assert first == second


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["certfy"], "verb=certfy: did you mean certify?"),
        (["ls"], "verb=ls: did you mean method=ls?"),
        (["tables", "what=clams"], "what=clams: did you mean claims?"),
        (["share"], "action=: needed"),
        (["share", "action=export"], "form=: petab, arviz or notebook"),
    ],
)
def test_a_verb_that_is_mistyped_is_one_line(words: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert err.startswith(f"bench: {said}")
