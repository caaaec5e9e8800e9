"""Write the folder of a round and that of its secret, open a round, and verify it.

The commitment is the SHA-256 of the secret seed, ``round.json`` (ranges and version of the code) and ``truth.csv``:
neither the seed nor the true values can be changed later, and without the seed (256 bits) no guess can be verified.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import math
import re
import shutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

from bench.config.files import read_yaml
from bench.entrants.registry import DISTRIBUTION
from bench.errors import InputError
from bench.rounds.draw import DrawnProblem, draw_round
from bench.rounds.problem_file import problem_files, short_name
from bench.rounds.secret import SEED_BYTES
from bench.store.provenance import commit

FORMAT = 1
ROUND, COMMITMENT, TRUTH, SECRET, OPENED = "round.json", "commitment.json", "truth.csv", "secret.json", "opened.json"
PROBLEMS, TEMPLATE, METHODS = "problems", "predictions_template.csv", "methods"
COLUMNS = ("scenario", "quantity", "value", "low", "high", "seconds")
TRUTH_COLUMNS = ("scenario", "quantity", "value", "bound", "kind")
RULE = "SHA-256 of three lines in hexadecimal: seed, SHA-256 of round.json, SHA-256 of truth.csv; each ends with \\n"
SAME = 2e-6
"""Largest relative difference of equal numbers: the seventh digit may be rounded differently by another processor."""
KNOWLEDGE = "a folder that python -m bench round new has written"
NUMBER = re.compile(r"([-+]?\d+(?:\.\d*)?(?:e[-+]?\d+)?)")


def write_round(out: Path, secret: Path, seed: int, scenarios: int) -> None:
    """Draw a round by a secret seed of 256 bits; write its folder, and the folder of seed and truth."""
    ranges = read_yaml("", "round")
    drawn = draw_round(seed, scenarios, ranges)
    stated = {
        "format": FORMAT, "name": out.name, "date": datetime.now(UTC).date().isoformat(), "scenarios": scenarios,
        "ranges": ranges, "version": version(DISTRIBUTION), **commit(),
    }  # fmt: skip
    public, truth = {ROUND: _json(stated), **_public_files(drawn)}, _truth_file(drawn)
    public[COMMITMENT] = _json({"rule": RULE, "commitment": commitment(seed, public[ROUND], truth)})
    readme = files("bench.rounds").joinpath("round_readme.md").read_text(encoding="utf-8")
    public["README.md"] = Template(readme).substitute(name=out.name, scenarios=scenarios)
    secret.mkdir(mode=0o700, parents=True)
    (out / PROBLEMS).mkdir(parents=True)
    _write(secret, {SECRET: _json({"seed": _hex(seed)}), TRUTH: truth})
    _write(out, public)


def _public_files(drawn: Iterable[DrawnProblem]) -> dict[str, str]:
    """Return the files of the problems and the template, by path in the folder of the round."""
    contents: dict[str, str] = {}
    for problem in drawn:
        pair = problem_files(problem.name, problem.problem, list(problem.truth))
        contents |= {f"{PROBLEMS}/{name}": text for name, text in pair.items()}
    rows = [(problem.name, short_name(quantity), "", "", "", "") for problem in drawn for quantity in problem.truth]
    return {**contents, TEMPLATE: table(COLUMNS, rows)}


def _truth_file(drawn: Iterable[DrawnProblem]) -> str:
    """Return the true values as CSV, with their bounds (standard deviations in the same unit)."""
    return table(TRUTH_COLUMNS, [
        (problem.name, short_name(quantity), f"{value:.10g}", f"{bound:.7g}", problem.kind)
        for problem in drawn for quantity, (value, bound) in problem.truth.items()
    ])  # fmt: skip


def table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return CSV of rows under a header."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([header, *rows])
    return text.getvalue()


def commitment(seed: int, round_file: str, truth: str) -> str:
    """Return the commitment to a seed and two files, by :data:`RULE`."""
    return _sha256(f"{_hex(seed)}\n{_sha256(round_file)}\n{_sha256(truth)}\n")


@dataclass(frozen=True)
class OpenedRound:
    """A round with its secret: the content of ``round.json``, the seed, and the text of ``truth.csv``."""

    stated: Mapping[str, Any]
    seed: int
    truth: str


def read_secret(folder: Path, secret: Path | None = None) -> OpenedRound:
    """Return a round with the secret of another folder, or, once it is opened, of the same folder.

    Raises InputError if the folders contain no round, or the secret does not match the commitment.
    """
    if not secret and not (folder / OPENED).is_file() and (folder / ROUND).is_file():
        raise InputError("secret", "", f"needed while {folder} is not opened: the folder of its seed and truth")
    field, place, name = ("secret", secret, SECRET) if secret else ("round", folder, OPENED)
    stated, promised = _read(folder, ROUND, "round"), _read(folder, COMMITMENT, "round")
    seed, truth = _read(place, name, field), _read(place, TRUTH, field)
    try:
        opened = OpenedRound(json.loads(stated), int(json.loads(seed)["seed"], 16), truth)
        kept = commitment(opened.seed, stated, truth) == json.loads(promised)["commitment"]
    except (KeyError, TypeError, ValueError, OverflowError):
        raise InputError("round", folder, "its files are damaged; get them again") from None
    if not kept:
        raise InputError(field, place, f"its seed and truth are not those of {folder / COMMITMENT}")
    return opened


def open_round(folder: Path, secret: Path) -> None:
    """Publish seed, truth and the predictions of this project's methods in the folder of the round."""
    opened = read_secret(folder, secret)
    if (secret / METHODS).is_dir():
        shutil.copytree(secret / METHODS, folder / METHODS, dirs_exist_ok=True)
    _write(folder, {TRUTH: opened.truth, OPENED: _json({"seed": _hex(opened.seed)})})


def verify_round(folder: Path, secret: Path | None = None) -> list[str]:
    """Draw the round again from its seed; returns a sentence for each file that differs.

    Raises InputError if seed and true values do not match the commitment, or there is no round.
    """
    opened = read_secret(folder, secret)
    drawn = draw_round(opened.seed, opened.stated["scenarios"], opened.stated["ranges"])
    expected = _public_files(drawn)
    present = {f"{PROBLEMS}/{path.name}" for path in (folder / PROBLEMS).glob("*")} | {TEMPLATE}
    differences = [] if _same(opened.truth, _truth_file(drawn)) else [f"{TRUTH} differs from what the seed gives"]
    differences += [f"{name} is missing" for name in sorted(expected.keys() - present)]
    differences += [f"{name} is no file of the round" for name in sorted(present - expected.keys())]
    differences += [
        f"{name} differs from what the seed gives" for name in sorted(expected.keys() & present)
        if not _same(_read(folder, name, "round"), expected[name])
    ]  # fmt: skip
    return differences


def problem_names(folder: Path) -> list[str]:
    """Return the names of the problems of a round; raises InputError if there are none."""
    names = sorted(path.stem for path in (folder / PROBLEMS).glob("*.json"))
    if not names:
        raise InputError("round", folder, f"no {PROBLEMS} are there; name {KNOWLEDGE}")
    return names


def _read(folder: Path | None, name: str, field: str) -> str:
    try:
        return Path(folder or "", name).read_bytes().decode("utf-8")
    except (OSError, UnicodeDecodeError):
        raise InputError(field, folder, f"no {name} can be read there; name {KNOWLEDGE}") from None


def read_json(folder: Path, name: str) -> Any:
    """Return the content of a JSON file of a round; raises InputError for a damaged file."""
    try:
        return json.loads(_read(folder, name, "round"))
    except ValueError:
        raise InputError("round", folder / name, "damaged; get it again") from None


def _write(folder: Path, contents: Mapping[str, str]) -> None:
    for name, text in contents.items():
        (folder / name).write_bytes(text.encode())


def _same(text: str, other: str) -> bool:
    """Return whether two texts agree, their numbers to :data:`SAME`."""
    parts, others = NUMBER.split(text), NUMBER.split(other)
    return len(parts) == len(others) and all(
        a == b or (i % 2 == 1 and math.isclose(float(a), float(b), rel_tol=SAME))
        for i, (a, b) in enumerate(zip(parts, others, strict=True))
    )


def _hex(seed: int) -> str:
    return f"{seed:0{2 * SEED_BYTES}x}"


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _json(content: Any) -> str:
    return json.dumps(content, indent=1, ensure_ascii=False) + "\n"
