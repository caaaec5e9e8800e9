"""Measured records on the command line: estimates of methods, with a plot in the terminal and a picture."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.config.fields import Config
from bench.config.overrides import Overrides
from bench.errors import InputError
from bench.reporting.whole_file import check_file, write

if TYPE_CHECKING:
    from bench.face.identification import Identification
    from bench.records.request import ModalRequest, Request
    from bench.records.response import Response

Shown = tuple[list["Identification"], "Response | None", str]


def identify_records(overrides: Overrides) -> int:
    """Print the estimates of methods on measured records; return 1 where none is to be trusted, else 0."""
    from bench.records.request import ModalRequest, modal_request_of, request_of
    from bench.reporting.record_page import methods_page
    from bench.reporting.terminal import wrapped
    from bench.reporting.terminal_plot import plotted, wanted

    several_modes = overrides.get("modes", [None]) != [None]
    request: Any = modal_request_of(overrides) if several_modes else request_of(overrides)
    config = request.config if isinstance(request, ModalRequest) else request.job.config
    table, picture = config.format == "table", _picture(config)
    plot = table and wanted(config.plot, sys.stdout)
    results, response, drawn = (_modes if several_modes else _answers)(request, plot, picture is not None)
    for result in results if not table else ():
        print(json.dumps(result.as_dict(), allow_nan=False))
    if table and (several_modes or len(results) == 1):
        print(*results, sep="\n\n")
    elif table:
        names = [name for name in results[0].estimates if any(name in other.estimates for other in results[1:])]
        print(methods_page([result.plain() for result in results], (names or ["k_over_m"])[:3]))
    if response is not None and plot:
        print(f"\n{plotted(response)}\n")
    if table:
        print(wrapped("results are not saved; format=json prints all of them, with residuals"))
    if picture and drawn:
        write(picture, drawn, field="picture")
        print(f"picture of the fit: {picture}", file=sys.stdout if table else sys.stderr)
    return int(all(result.trust == "do not trust" for result in results))


def _answers(request: Request, plot: bool, picture: bool) -> Shown:
    """Return the results, the response that a terminal plots, and the content of a picture."""
    from bench.face.identification import identified
    from bench.records.identification import identify_all
    from bench.records.problem import read_measured
    from bench.records.response import best_of, response_of
    from bench.reporting.certificate.pictures import fit_picture

    findings = identify_all(request, read_measured(request))
    response = response_of(best_of(findings)) if plot or picture else None
    return (
        [identified(finding) for finding in findings],
        response,
        fit_picture(response) if picture and response else "",
    )


def _modes(request: ModalRequest, plot: bool, picture: bool) -> Shown:
    from bench.face.identification import identified_modes
    from bench.records.modal import find_modes, modal_response
    from bench.records.modal_data import read_modal
    from bench.reporting.certificate.pictures import modes_picture

    findings = [finding for record in read_modal(request) for finding in find_modes(request, record)]
    best = min(findings, key=lambda finding: finding.trust.severity)
    drawn = modes_picture(best) if picture else ""
    return [identified_modes(finding) for finding in findings], modal_response(best) if plot else None, drawn


def _picture(config: Config) -> Path | None:
    """Return the file of the picture, None for none; raises InputError, before any work, where it cannot be written."""
    if config.format == "json" and config.plot == "always":
        raise InputError("plot", config.plot, "use it with format=table")
    if config.picture is None:
        return None
    path = Path(config.picture)
    if path.suffix.lower() != ".svg":
        raise InputError("picture", config.picture, "a file whose name ends in .svg")
    check_file(path, "picture")
    return path
