"""Read predictions of a round from a CSV file.

Every row is checked before anything is scored; an error names the line, the column, the value, and a remedy.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from bench.errors import InputError, check_name, did_you_mean
from bench.files import read_regular
from bench.records.reading.grid import MISSING, NUMBER
from bench.records.reading.text import THOUSANDS, decode
from bench.rounds.folder import COLUMNS, KNOWLEDGE, TEMPLATE

if TYPE_CHECKING:
    import pandas as pd

HEADER, NUMBERS = ",".join(COLUMNS), COLUMNS[2:]
LARGEST_FILE_MB = 10
"""Largest size of a file of predictions; a row has about fifty bytes."""

Asked = Mapping[str, Sequence[str]]
"""Requested quantities, by scenario."""
Row = dict[str, str]
Errors = dict[int, InputError]
"""Errors of a file, by line."""


def read_template(folder: Path) -> Asked:
    """Return the requested quantities of a round, by scenario; raises InputError if the folder is no round."""
    if not (folder / TEMPLATE).is_file():
        raise InputError("round", folder, f"no {TEMPLATE} is there; {KNOWLEDGE}")
    requested: dict[str, list[str]] = {}
    for row in _read_rows(folder / TEMPLATE)[0].values():
        requested.setdefault(row["scenario"], []).append(row["quantity"])
    return requested


def read_predictions(path: Path, requested: Asked) -> tuple[pd.DataFrame, bool, list[InputError]]:
    """Read a file of predictions.

    Returns:
        The predictions, one row per requested quantity in order, with NaN for missing numbers; whether commas were read
        as decimal marks; and the errors of the file. The predictions are valid only without errors.

    Raises:
        InputError: the file is no table with the columns of the template.
    """
    import pandas as pd

    rows, errors = _read_rows(path)
    decimal_comma = _has_decimal_commas([row.get(name, "") for row in rows.values() for name in NUMBERS])
    lines: dict[tuple[str, str], int] = {}
    values = {}
    for line, row in rows.items():
        try:
            key = _key(row, requested)
            if lines.setdefault(key, line) != line:
                raise InputError("quantity", key[1], f"line {lines[key]} answers it already; keep one of them")
            values[key] = _numbers(row, decimal_comma)
        except InputError as error:
            errors[line] = InputError(f"{path.name} line {line}, {error.field}", error.value, error.remedy)
    questions = [(scenario, quantity) for scenario, quantities in requested.items() for quantity in quantities]
    remedy = "no row; every row of the template is needed, its value empty where there is no answer"
    missing = [InputError(f"{path.name}, {key[0]}", key[1], remedy) for key in questions if key not in lines]
    table = pd.DataFrame([(*key, *values.get(key, [math.nan] * 4)) for key in questions], columns=COLUMNS)
    return table, decimal_comma, [errors[line] for line in sorted(errors)] or missing


def _read_rows(path: Path) -> tuple[dict[int, Row], Errors]:
    """Return the rows below the header by line, and the lines that do not have the header's columns."""
    body = [(i, line) for i, line in enumerate(_text(path).splitlines(), 1) if line.strip(" ,;\t")]
    body = [(i, line) for i, line in body if not line.lstrip().startswith("#")]
    if len(body) < 2:
        raise InputError(
            "predictions", path, f"empty; the first line is {HEADER}, and every row of the template follows"
        )
    separator = max(",;\t", key=body[0][1].count)
    header = _header(body[0][1], separator, f"{path.name} line {body[0][0]}, header")
    named, rows, errors = sum(map(bool, header)), dict[int, Row](), Errors()
    for line, text in body[1:]:
        try:
            cells = [cell.strip() for cell in next(csv.reader([text], delimiter=separator, strict=True))]
        except csv.Error:
            errors[line] = InputError(f"{path.name} line {line}, row", text, "close every quote")
            continue
        if len(cells) == len(header) and all(name or not cell for name, cell in zip(header, cells, strict=True)):
            rows[line] = dict(zip(header, cells, strict=True))
        else:
            hint = "a decimal comma?" if len(cells) > named else "write a separator for an empty column too"
            remedy = f"{len(cells)} columns, the header names {named}; {hint}"
            errors[line] = InputError(f"{path.name} line {line}, row", text, remedy)
    return rows, errors


def _text(path: Path) -> str:
    if path.stat().st_size > LARGEST_FILE_MB * 1_000_000:
        raise InputError("predictions", path, f"larger than {LARGEST_FILE_MB} MB; one row for each quantity is enough")
    try:
        return decode(read_regular(path), path)
    except InputError:
        raise InputError("predictions", path, "a packed or binary file; save it as CSV") from None


def _header(line: str, separator: str, where: str) -> list[str]:
    """Return the names of the columns; raises InputError for unknown, repeated or missing ones."""
    names = [name.strip().strip('"').lower() for name in line.split(separator)]
    named = [name for name in names if name]  # a spreadsheet may write empty columns at the end
    for name in named:
        check_name(where, name, COLUMNS, "; no row numbers")
    ends = ("low", "high") if {"low", "high"} & set(names) else ()
    for name in ("scenario", "quantity", "value", *ends, *named):
        if names.count(name) != 1:
            raise InputError(where, line, f"one column {name} is needed; columns are {HEADER}")
    return names


def _has_decimal_commas(texts: Sequence[str]) -> bool:
    """Decide whether commas in numbers are decimal marks: no number has a point, and not all may mean thousands."""
    commas = [text for text in texts if "," in text]
    return any(not THOUSANDS.fullmatch(text) for text in commas) and not any("." in text for text in texts)


def _key(row: Row, requested: Asked) -> tuple[str, str]:
    scenario, names = row["scenario"], list(requested)
    if scenario not in requested:
        near = did_you_mean(scenario, names)
        raise InputError("scenario", scenario, f"{near}scenarios of this round are {names[0]} to {names[-1]}")
    check_name("quantity", row["quantity"], requested[scenario], f": what this round asks for in {scenario}")
    return scenario, row["quantity"]


def _numbers(row: Row, decimal_comma: bool) -> tuple[float, ...]:
    """Return the numbers of a row in the order of :data:`NUMBERS`; raises InputError."""
    value, low, high, seconds = (_number(name, row.get(name, ""), decimal_comma) for name in NUMBERS)
    if math.isnan(low) != math.isnan(high):
        raise InputError("low" if math.isnan(low) else "high", "", "give both ends of the interval, or none")
    if math.isnan(value) and not math.isnan(low):
        raise InputError("value", "", "an interval without a value; give the value, or no interval")
    if low > high:
        raise InputError("low", row["low"], f"above high={row['high']}; low is the lower end of the 95 % interval")
    if value < low or value > high:
        raise InputError("value", row["value"], f"outside its interval, {row['low']} to {row['high']}")
    if seconds < 0:
        raise InputError("seconds", row["seconds"], "negative; the time of the fit in seconds, or nothing")
    return value, low, high, seconds


def _number(column: str, text: str, decimal_comma: bool) -> float:
    """Return the number of a cell, NaN of an empty one; raises InputError."""
    plain = text.replace("−", "-").replace(",", "." if decimal_comma else ",")
    if not plain:
        return math.nan
    if NUMBER.fullmatch(plain) and math.isfinite(number := float(plain.lower().replace("d", "e"))):
        return number
    if plain.lower() in MISSING:
        raise InputError(column, text, "leave it empty where there is no answer")
    if "," in text:
        raise InputError(column, text, "a decimal comma or a separator of thousands? write 1234.5")
    raise InputError(column, text, "write one real number below 1e308, without unit or separators, such as 1234.5")
