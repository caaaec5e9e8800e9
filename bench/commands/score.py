"""The verb ``score``: score a file of predictions of a round."""

from __future__ import annotations

import hashlib
from io import StringIO
from pathlib import Path
from typing import Annotated

from bench.commands.declaration import Bare, file, folder
from bench.commands.log import LOG
from bench.errors import InputError, line_of

MOST_SHOWN = 10
"""Number of errors of a file that are printed."""


def score(
    predictions: Annotated[Path, Bare(), "CSV: scenario,quantity,value,low,high,seconds"],
    round: Annotated[Path, Bare(), "folder of the round"],
    secret: Annotated[Path | None, "folder of seed and truth, if the round is not yet opened"] = None,
    name: Annotated[str | None, "name of the method [that of the file]"] = None,
    out: Annotated[Path | None, "folder of score.md: a line to cite, the tables, and what they are of"] = None,
) -> int:
    """Score a file of predictions of a round, and compare it with those in the folder methods of seed and truth.

    The file has one row per quantity of each problem, without a value where there is no estimate; low and high are the
    ends of a 95 % interval, seconds the time of the fit. A file with an error is not scored. Without the truth the file
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

    template = read_template(folder("round", round))
    hidden = folder("secret", secret) if secret else round if (round / OPENED).exists() else None
    label = " ".join((name or predictions.stem).split())
    files = {path.stem: path for path in sorted((hidden / METHODS).glob("*.csv"))} if hidden else {}
    if label in files:
        raise InputError("name", label, "a method of the comparison has this name; give another one")
    tables = {}
    for method, path in {label: file("predictions", predictions, "name the CSV of predictions"), **files}.items():
        tables[method], decimal_comma, errors = read_predictions(path, template)
        if errors:
            shown = [*map(line_of, errors[:MOST_SHOWN]), f"and {len(errors) - MOST_SHOWN} more"]
            LOG.error("\nbench: ".join(shown[: len(errors)]))
            return 2
        if decimal_comma:
            LOG.warning("%s: commas are read as decimal marks", path)
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
    print(report.text(), line, sep="\n\n")
    if out:
        write(out / "score.md", report.page(line, origin), out)
        print(f"\n{out / 'score.md'}")
    return 0
