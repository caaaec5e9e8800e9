"""The folder of a round and that of its secret: written, opened when the round is over, and verified by its readers.

The commitment is the SHA-256 of the secret seed, ``round.json`` (ranges and version of the code) and ``truth.csv``:
neither seed nor truth can be exchanged later, and without the seed, of 256 bits, no guess of the truth can be tested.
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
from bench.rounds.secret import BITS
from bench.store.provenance import commit

FORMAT = 1
ROUND, COMMITMENT, TRUTH, SECRET, OPENED = "round.json", "commitment.json", "truth.csv", "secret.json", "opened.json"
PROBLEMS, TEMPLATE, METHODS = "problems", "predictions_template.csv", "methods"
COLUMNS = ("scenario", "quantity", "value", "low", "high", "seconds")
TRUTH_COLUMNS = ("scenario", "quantity", "value", "bound", "kind")
RULE = "SHA-256 of three lines in hexadecimal: seed, SHA-256 of round.json, SHA-256 of truth.csv; each ends with \\n"
SAME = 2e-6
"""Relative difference up to which numbers are the same: another processor may round the seventh digit otherwise."""
NUMBER = re.compile(r"([-+]?\d+(?:\.\d*)?(?:e[-+]?\d+)?)")
KNOWLEDGE = "a folder that python -m bench round new has written"


def write_round(out: Path, secret: Path, seed: int, scenarios: int) -> None:
    """Draw a round by a secret seed and write its folder, and the folder of seed and truth."""
    ranges = read_yaml("", "round")
    drawn = draw_round(seed, scenarios, ranges)
    stated = {
        "format": FORMAT, "name": out.name, "date": datetime.now(UTC).date().isoformat(), "scenarios": scenarios,
        "ranges": ranges, "version": version(DISTRIBUTION), **commit(),
    }  # fmt: skip
    contents = {ROUND: _json(stated), **_public_files(drawn)}
    truth = truth_file(drawn)
    readme = Template(files("bench.rounds").joinpath("round_readme.md").read_text(encoding="utf-8"))
    contents["README.md"] = readme.substitute(name=out.name, scenarios=scenarios)
    contents[COMMITMENT] = _json({"rule": RULE, "commitment": commitment(seed, contents[ROUND], truth)})
    (out / PROBLEMS).mkdir(parents=True)
    secret.mkdir(mode=0o700, parents=True)
    for folder, texts in ((secret, {SECRET: _json({"seed": _hex(seed)}), TRUTH: truth}), (out, contents)):
        for name, text in texts.items():
            (folder / name).write_text(text, encoding="utf-8", newline="\n")


def _public_files(drawn: Iterable[DrawnProblem]) -> dict[str, str]:
    """Return problems and template by their place in the folder of the round."""
    contents: dict[str, str] = {}
    rows: list[tuple[str, ...]] = []
    for problem in drawn:
        pair = problem_files(problem.name, problem.problem, list(problem.truth))
        contents |= {f"{PROBLEMS}/{name}": text for name, text in pair.items()}
        rows += [(problem.name, short_name(quantity), "", "", "", "") for quantity in problem.truth]
    return {**contents, TEMPLATE: table(COLUMNS, rows)}


def truth_file(drawn: Iterable[DrawnProblem]) -> str:
    """Return the truth as CSV: the value of each quantity and its bound, a standard deviation in the same unit."""
    rows = [
        (problem.name, short_name(quantity), f"{value:.10g}", f"{bound:.7g}", problem.kind)
        for problem in drawn
        for quantity, (value, bound) in problem.truth.items()
    ]
    return table(TRUTH_COLUMNS, rows)


def table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return CSV of rows under a header."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([header, *rows])
    return text.getvalue()


def commitment(seed: int, round_file: str, truth: str) -> str:
    """Return the commitment to a seed and two files, by :data:`RULE`."""
    return _sha256("".join(f"{line}\n" for line in (_hex(seed), _sha256(round_file), _sha256(truth))))


@dataclass(frozen=True)
class OpenedRound:
    """A round with its secret: what ``round.json`` states, the seed and the text of the truth."""

    stated: Mapping[str, Any]
    seed: int
    truth: str


def read_secret(folder: Path, secret: Path | None = None) -> OpenedRound:
    """Return a round with the secret of another folder, or with its own once it is opened.

    Raises InputError where the folders hold no round, or the secret is not the one that the round is committed to.
    """
    stated, committed = read_text(folder, ROUND), read_json(folder, COMMITMENT)
    if secret is None and not (folder / OPENED).exists():
        raise InputError("secret", "", f"the folder with {SECRET}: {folder} is not opened yet")
    try:
        key = read_json(secret, SECRET) if secret else read_json(folder, OPENED)
        opened = OpenedRound(json.loads(stated), int(key["seed"], 16), read_text(secret or folder, TRUTH))
        promised = committed["commitment"]
    except (KeyError, TypeError, ValueError) as error:
        raise error if isinstance(error, InputError) else InputError("round", folder, KNOWLEDGE) from None
    if not 0 <= opened.seed < 2**BITS or commitment(opened.seed, stated, opened.truth) != promised:
        raise InputError("secret" if secret else "round", secret or folder, f"not the seed and truth of {COMMITMENT}")
    return opened


def open_round(folder: Path, secret: Path) -> None:
    """Publish seed, truth and the predictions of this project's methods in the folder of the round."""
    opened = read_secret(folder, secret)
    if (secret / METHODS).is_dir():
        shutil.copytree(secret / METHODS, folder / METHODS, dirs_exist_ok=True)
    (folder / TRUTH).write_text(opened.truth, encoding="utf-8", newline="\n")
    (folder / OPENED).write_text(_json({"seed": _hex(opened.seed)}), encoding="utf-8", newline="\n")


def verify_round(folder: Path, secret: Path | None = None) -> list[str]:
    """Draw the round of its seed again; returns a sentence for each file that differs or is not the round's.

    Raises InputError where seed and truth are not those of the commitment, or no round is there.
    """
    opened = read_secret(folder, secret)
    drawn = draw_round(opened.seed, opened.stated["scenarios"], opened.stated["ranges"])
    expected = {**_public_files(drawn), TRUTH: truth_file(drawn)}
    differences = []
    for name, text in expected.items():
        place = secret if secret and name == TRUTH else folder
        if not (place / name).is_file():
            differences.append(f"{name} is missing")
        elif not _same((place / name).read_text(encoding="utf-8"), text):
            differences.append(f"{name} differs from what the seed gives")
    known = {folder / name for name in expected}
    extra = sorted(path.name for path in (folder / PROBLEMS).iterdir() if path not in known)
    return differences + [f"{PROBLEMS}/{name} is no file of the round" for name in extra]


def problem_names(folder: Path) -> list[str]:
    """Return the names of the problems of a round; raises InputError where there is none."""
    names = sorted(path.stem for path in (folder / PROBLEMS).glob("*.json"))
    if not names:
        raise InputError("round", folder, KNOWLEDGE)
    return names


def read_text(folder: Path, name: str) -> str:
    """Return the text of a file of a round; raises InputError where it cannot be read."""
    try:
        return (folder / name).read_bytes().decode("utf-8")
    except (OSError, UnicodeDecodeError):
        field = "secret" if name == SECRET else "round"
        raise InputError(field, folder, f"no {name} can be read there; {KNOWLEDGE}") from None


def read_json(folder: Path, name: str) -> Any:
    """Return the content of a JSON file of a round; raises InputError where it is none."""
    try:
        return json.loads(read_text(folder, name))
    except json.JSONDecodeError:
        raise InputError("round", folder / name, "damaged: no JSON") from None


def _same(text: str, other: str) -> bool:
    """Return whether two texts agree, their numbers to :data:`SAME`."""
    parts, others = NUMBER.split(text), NUMBER.split(other)
    return len(parts) == len(others) and all(
        a == b or (i % 2 == 1 and math.isclose(float(a), float(b), rel_tol=SAME))
        for i, (a, b) in enumerate(zip(parts, others, strict=True))
    )


def _hex(seed: int) -> str:
    return f"{seed:0{BITS // 4}x}"


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _json(content: Any) -> str:
    return json.dumps(content, indent=1, ensure_ascii=False) + "\n"
