"""Measured records on the command line: what methods find in them, with a plot in the terminal and a picture."""

from __future__ import annotations

import json
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from bench.config.fields import Config
from bench.config.overrides import Overrides
from bench.config.schema import Job
from bench.errors import InputError, line_of
from bench.reporting.whole_file import check_file, write

NONE = "none"
FOLDER = "fits"
"""Beside the folder of the cells."""
NO_MATPLOTLIB = "matplotlib is missing: pip install 'vibration-bench[figures]'"


def identify_records(overrides: Overrides) -> int:
    """Print what methods find in measured records; 1 where no method's answer is to be trusted."""
    from bench.face.identification import found_by, identified
    from bench.measured.record import read_measured
    from bench.measured.request import request_of

    request = request_of(overrides)
    _check_pictures(request.job)
    findings = found_by(request, read_measured(request))
    results = [identified(finding) for finding in findings]
    if request.job.config.format == "json":
        for own in results:
            print(json.dumps(own.as_dict(), allow_nan=False))
    else:
        print(_page(results))
    _pictures(request.job, request.files[0], findings)
    return int(all(own.trust == "do not trust" for own in results))


def _page(results: Any) -> str:
    from bench.reporting.record_page import methods_page

    if len(results) == 1:
        return str(results[0])
    names = [name for name in results[0].estimates if any(name in own.estimates for own in results[1:])]
    return methods_page([own._plain() for own in results], (names or ["k_over_m"])[:3])


def _check_pictures(job: Job) -> None:
    """Raise InputError, before any work, where a plot or a picture that is asked for cannot be."""
    config = job.config
    if config.format == "json" and config.plot == "always":
        raise InputError("plot", config.plot, "with format=table; programs read the JSON")
    if config.picture in (None, NONE):
        return
    path = Path(config.picture)
    if path.suffix.lower() != ".svg":
        raise InputError("picture", config.picture, "a file whose name ends in .svg, or none")
    if find_spec("matplotlib") is None:
        raise InputError("picture", config.picture, NO_MATPLOTLIB)
    check_file(path, "picture")


def _pictures(job: Job, record: Path, findings: Any) -> None:
    """The fit of the best method as a plot, where one is wanted, and as a file."""
    from bench.measured.response import best_of, response_of
    from bench.reporting.terminal import wrapped
    from bench.reporting.terminal_plot import plotted, wanted

    config, table = job.config, job.config.format == "table"
    plot = table and wanted(config.plot, sys.stdout)
    picture = config.picture != NONE and (table or config.picture is not None)
    response = response_of(best_of(findings)) if plot or picture else None
    if response is not None and plot:
        print(f"\n{plotted(response)}\n")
    if table:
        print(wrapped("the values are not stored: format=json prints all, with residuals"))
    if response is not None and picture:
        path = Path(config.picture) if config.picture else _beside_store(config, record, response.method)
        _save(path, response, asked=config.picture is not None, stream=sys.stdout if table else sys.stderr)


def _beside_store(config: Config, record: Path, method: str) -> Path:
    return Path(config.store).parent / FOLDER / f"{record.stem}_{method}.svg"


def _save(path: Path, response: Any, asked: bool, stream: Any) -> None:
    """Write the picture and say where; one that nobody asked for and that cannot be written spoils nothing."""
    from bench.reporting.fit_picture import fit_picture

    try:
        write(path, fit_picture(response), field="picture")
    except ImportError:
        print(f"bench: no picture of the fit, since {NO_MATPLOTLIB}", file=sys.stderr)
    except InputError as error:
        if asked:
            raise
        print(f"bench: no picture of the fit: {line_of(error)}", file=sys.stderr)
    else:
        print(f"picture of the fit: {path}", file=stream)
