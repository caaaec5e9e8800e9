"""The verb ``score``: a file of predictions of a round."""

from __future__ import annotations

import hashlib
import sys
from io import StringIO
from pathlib import Path
from typing import Annotated

from bench.commands.declaration import Bare, file, folder
from bench.errors import InputError, line_of

MOST_SHOWN = 10
"""Errors of a file that are printed."""


def score(
    predictions: Annotated[Path, Bare(), "CSV: scenario,quantity,value,low,high,seconds"],
    round: Annotated[Path, Bare(), "folder of the round"],
    secret: Annotated[Path | None, "folder of its seed and truth, of a round that is not opened yet"] = None,
    name: Annotated[str | None, "name of what is scored [that of the file]"] = None,
    out: Annotated[Path | None, "folder of score.html, a page, and score.md, a line to cite"] = None,
) -> int:
    """Score a file of predictions of a round, beside the predictions in the folder methods of seed and truth.

    Every quantity that the round asks for has a row, whose value is empty where there is no answer; low and high are
    the ends of a 95 % interval, seconds the time of the fit. A file with an error is not scored. Without the truth it
    is only checked.
    Exit status: 0, 2 for bad input.
    """
    import pandas as pd

    from bench import __version__
    from bench.reporting.round_score import round_report
    from bench.reporting.whole_file import check_folder, write
    from bench.rounds.folder import COMMITMENT, METHODS, OPENED, read_json, read_secret
    from bench.rounds.predictions import read_predictions, read_template
    from bench.rounds.scoring import score_rows

    asked = read_template(folder("round", round))
    hidden = folder("secret", secret) if secret else round if (round / OPENED).exists() else None
    label = " ".join((name or predictions.stem).split())
    files = {path.stem: path for path in sorted((hidden / METHODS).glob("*.csv"))} if hidden else {}
    if label in files:
        raise InputError("name", label, "a method that it is compared with is called so; give another name")
    tables = {}
    for method, path in {label: file("predictions", predictions, "name the CSV of predictions"), **files}.items():
        tables[method], decimal_comma, errors = read_predictions(path, asked)
        if errors:
            shown = [*map(line_of, errors[:MOST_SHOWN]), f"and {len(errors) - MOST_SHOWN} more"]
            print(*(f"bench: {line}" for line in shown[: len(errors)]), sep="\n", file=sys.stderr)
            return 2
        if decimal_comma:
            print(f"bench: {path}: commas are read as decimal marks", file=sys.stderr)
    if hidden is None:
        values = tables[label]["value"]
        print(f"{predictions}: no errors, {values.count()} of {values.size} values given")
        print(f"not scored: {round} is not opened, and only its organiser has the truth (secret=)")
        return 0
    opened, commitment = read_secret(round, secret), read_json(round, COMMITMENT)["commitment"]
    if out:
        check_folder(out)
    truth = pd.read_csv(StringIO(opened.truth))
    report = round_report(label, {method: score_rows(table, truth) for method, table in tables.items()})
    line = report.line(opened.stated["name"], commitment)
    origin = {
        "Round": opened.stated["name"], "Commitment": commitment, "Predictions": predictions.name,
        "SHA-256 of the predictions": hashlib.sha256(predictions.read_bytes()).hexdigest(),
        "Version of vibration-bench": __version__,
    }  # fmt: skip
    pages = {out / "score.html": report.page(line, origin), out / "score.md": f"{line}\n"} if out else {}
    for path, text in pages.items():
        write(path, text, out)
    print(report.text(), line, "\n".join(map(str, pages)), sep="\n\n")
    return 0
