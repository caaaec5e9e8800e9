"""Files of predictions, well written and not: what is wrong is one line each, and nothing is scored."""

from __future__ import annotations

import gzip
import math
import os
import zipfile
from pathlib import Path

import numpy as np
import pytest

from bench.commands.main import main
from bench.rounds.predictions import HEADER, read_predictions

ASKED = {"P001": ["k/m", "c/m"], "P002": ["m", "c1"]}
ROWS = ("P001,k/m,8.1,7.5,8.9,0.2", "P001,c/m,0.4,,,", "P002,m,1e-2,0.009,0.011,3", "P002,c1,,,,")
GOOD = "\n".join((HEADER, *ROWS))


def changed(line: int, row: str) -> str:
    """Return the good file with another line, counted from 1."""
    lines = GOOD.split("\n")
    lines[line - 1] = row
    return "\n".join(lines)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The folder of a round that is not opened, as far as reading predictions needs it."""
    rows = [f"{scenario},{quantity},,,," for scenario, quantities in ASKED.items() for quantity in quantities]
    (tmp_path / "round").mkdir()
    (tmp_path / "round" / "predictions_template.csv").write_text("\n".join([HEADER, *rows]))
    return tmp_path / "round"


SEMICOLONS = GOOD.replace(",", ";")
WELL_WRITTEN = {
    "as the template": GOOD,
    "columns in another order": "value,high,low,seconds,Quantity,SCENARIO\n"
    "8.1,8.9,7.5,0.2,k/m,P001\n.4,,,,c/m,P001\n0.01,0.011,0.009,3,m,P002\n,,,,c1,P002",
    "rows in another order": "\n".join((HEADER, *ROWS[::-1])),
    "semicolons": SEMICOLONS,
    "semicolons and decimal commas": SEMICOLONS.replace(".", ","),
    "tabs": GOOD.replace(",", "\t"),
    "quoted": "\n".join(",".join(f'"{cell}"' for cell in line.split(",")) for line in GOOD.split("\n")),
    "quoted decimal commas": GOOD.replace("8.1,7.5,8.9,0.2", '"8,1","7,5","8,9","0,2"')
    .replace("0.4", '"0,4"')
    .replace("0.009,0.011", '"0,009","0,011"'),
    "CRLF, empty lines, comments, blanks": "# by hand\r\n\r\n"
    + GOOD.replace("\n", "\r\n,,,,,\r\n").replace(",", " , "),
    "trailing commas everywhere": GOOD.replace("\n", ",,\n") + ",,",
    "BOM": b"\xef\xbb\xbf" + GOOD.encode(),
    "UTF-16 with BOM": GOOD.encode("utf-16"),
    "UTF-16 without BOM": (GOOD + "\n" * (len(GOOD) % 2)).encode("utf-16-le"),
    "minus sign and Fortran's exponent": changed(3, "P001,c/m,4.0D-01,−1,1,"),
}


@pytest.mark.parametrize("text", WELL_WRITTEN.values(), ids=WELL_WRITTEN)
def test_a_file_that_has_one_reading_is_read(tmp_path: Path, text: str | bytes) -> None:
    path = tmp_path / "mine.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    table, decimal_comma, errors = read_predictions(path, ASKED)
    assert not errors
    assert list(zip(table["scenario"], table["quantity"], strict=True)) == [
        ("P001", "k/m"), ("P001", "c/m"), ("P002", "m"), ("P002", "c1"),
    ]  # fmt: skip
    np.testing.assert_array_equal(table["value"], [8.1, 0.4, 0.01, math.nan])
    np.testing.assert_array_equal(table["high"].iloc[[0, 2, 3]], [8.9, 0.011, math.nan])
    np.testing.assert_array_equal(table["seconds"], [0.2, math.nan, 3.0, math.nan])
    assert decimal_comma == (b"8,1" in path.read_bytes())


def test_low_high_and_seconds_are_optional(tmp_path: Path) -> None:
    path = tmp_path / "mine.csv"
    path.write_text("scenario,quantity,value\nP001,k/m,8\nP001,c/m,1\nP002,m,1\nP002,c1,")
    table, _, errors = read_predictions(path, ASKED)
    assert not errors
    assert table[["low", "high", "seconds"]].isna().all(axis=None)


MALFORMED: dict[str, tuple[str | bytes, str, str]] = {
    # what is written; the beginning of the error (@: of a line), with field and value; a part of what would be right
    "empty": ("", "predictions=", "the first line is scenario,quantity"),
    "header alone": (HEADER, "predictions=", "every row of the template follows"),
    "no header": ("\n".join(ROWS), "@1, header=p001", "one of scenario, quantity"),
    "a column misspelt": (GOOD.replace("high", "hihg", 1), "@1, header=hihg", "did you mean high?"),
    "an extra column": (GOOD.replace("seconds", "seconds,remark"), "@1, header=remark", "one of scenario"),
    "a column twice": (GOOD.replace("low", "high", 1), "@1, header=scenario", "one column low"),
    "row numbers": (changed(1, f"row,{HEADER}"), "@1, header=row", "no row numbers"),
    "no column of values": ("scenario,quantity\nP001,k/m", "@1, header=scenario", "one column value"),
    "low alone in the header": ("scenario,quantity,value,low\nP001,k/m,8,7", "@1, header=", "one column high"),
    "separators mixed": (changed(3, ROWS[1].replace(",", ";")), "@3, row=P001;c/m", "1 columns, the header names 6"),
    "too few columns": (changed(5, "P002,c1,"), "@5, row=P002,c1,", "3 columns, the header names 6"),
    "too many columns": (changed(3, "P001,c/m,0,4,,,"), "@3, row=P001,c/m,0,4,,,", "7 columns, the header names 6"),
    "a cell of no column": (GOOD.replace("\n", ",\n").replace("0.2,", "0.2,7") + ",", "@2, row=", "names 6"),
    "a quote left open": (changed(3, '"P001,c/m,0.4,,,'), "@3, row=", "close every quote"),
    "NaN": (changed(3, "P001,c/m,NaN,,,"), "@3, value=NaN", "leave it empty where there is no answer"),
    "infinite": (changed(3, "P001,c/m,0.4,-inf,inf,"), "@3, low=-inf", "leave it empty"),
    "text": (changed(3, "P001,c/m,about 1,,,"), "@3, value=about 1", "one real number"),
    "a unit": (changed(3, "P001,c/m,0.4 1/s,,,"), "@3, value=0.4 1/s", "without unit"),
    "hexadecimal": (changed(3, "P001,c/m,0x1F,,,"), "@3, value=0x1F", "one real number"),
    "below 1e308": (changed(3, "P001,c/m,1e400,,,"), "@3, value=1e400", "below 1e308"),
    "thousands": (changed(2, 'P001,k/m,"1,234.5",,,'), "@2, value=1,234.5", "thousands"),
    "thousands or decimals": (
        SEMICOLONS.replace("8.1;7.5;8.9;0.2", "1,234;;;").replace("0.4", "4").replace("1e-2;0.009;0.011", "1;;"),
        "@2, value=1,234", "1234.5",
    ),
    "points and decimal commas": (SEMICOLONS.replace("8.1", "8,1"), "@2, value=8,1", "1234.5"),
    "thousands by a blank": (changed(2, "P001,k/m,1 234.5,,,"), "@2, value=1 234.5", "separators"),
    "low above high": (changed(2, "P001,k/m,8.1,8.9,7.5,"), "@2, low=8.9", "above high=7.5"),
    "value outside": (changed(2, "P001,k/m,9.1,7.5,8.9,"), "@2, value=9.1", "outside its interval, 7.5 to 8.9"),
    "low without high": (changed(2, "P001,k/m,8.1,7.5,,"), "@2, high=:", "both ends"),
    "an interval without a value": (changed(2, "P001,k/m,,7.5,8.9,"), "@2, value=:", "give the value"),
    "negative seconds": (changed(2, "P001,k/m,8.1,,,-1"), "@2, seconds=-1", "negative"),
    "unknown scenario": (changed(2, "P0O1,k/m,8.1,,,"), "@2, scenario=P0O1", "did you mean P001?"),
    "unknown quantity": (changed(2, "P001,k_over_m,8.1,,,"), "@2, quantity=k_over_m", "one of k/m, c/m: what"),
    "a row twice": (GOOD + "\n" + ROWS[0], "@6, quantity=k/m", "line 2 answers it already"),
    "a row missing": ("\n".join((HEADER, *ROWS[1:])), "mine.csv, P001=k/m", "no row"),
    "gzip": (gzip.compress(GOOD.encode()), "predictions=", "packed"),
    "binary": (bytes(range(256)) * 4, "predictions=", "binary"),
}  # fmt: skip


@pytest.mark.parametrize(("content", "start", "remedy"), MALFORMED.values(), ids=MALFORMED)
def test_a_malformed_file_is_refused_in_one_line(
    folder: Path, capsys: pytest.CaptureFixture[str], content: str | bytes, start: str, remedy: str
) -> None:
    path = folder.parent / "mine.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    assert main(["score", str(path), f"round={folder}"]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    (line,) = printed.err.splitlines()
    whole = start.replace("@", "mine.csv line ").replace("predictions=", f"predictions={path}")
    assert line.startswith(f"bench: {whole}")
    assert remedy in line


def test_files_that_are_no_csv_are_refused_before_they_are_read(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    place = folder.parent
    with zipfile.ZipFile(place / "mine.xlsx", "w") as archive:
        archive.writestr("xl/workbook.xml", "<workbook/>")
    (place / "large.csv").touch()
    os.truncate(place / "large.csv", 2**30)
    os.mkfifo(place / "pipe.csv")
    expected = {"mine.xlsx": "save it as CSV", "large.csv": "larger than 10 MB", "pipe.csv": "not a file",
                "round": "not a file", "absent.csv": "file not found"}  # fmt: skip
    for name, remedy in expected.items():
        assert main(["score", str(place / name), f"round={folder}"]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith(f"bench: predictions={place / name}: ")
        assert remedy in line


def test_of_many_errors_ten_are_named_in_the_order_of_the_file(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = folder.parent / "mine.csv"
    path.write_text("\n".join([HEADER, *(f"P{i:03d},k/m,8.1" + "," * (3 + i % 2) for i in range(100, 113))]))
    assert main(["score", str(path), f"round={folder}"]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert [line.split(",")[0] for line in lines[:10]] == [f"bench: mine.csv line {i}" for i in range(2, 12)]
    assert lines[10:] == ["bench: and 3 more"]


def test_a_folder_that_is_no_round_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "mine.csv").write_text(GOOD)
    assert main(["score", str(tmp_path / "mine.csv"), f"round={tmp_path}"]) == 2
    assert "predictions_template.csv" in capsys.readouterr().err


def test_of_a_round_that_is_not_opened_a_file_is_only_checked(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder.parent / "mine.csv").write_text(GOOD)
    assert main(["score", str(folder.parent / "mine.csv"), f"round={folder}"]) == 0
    printed = capsys.readouterr().out
    assert "no errors, 3 of 4 values given" in printed
    assert "not scored" in printed
