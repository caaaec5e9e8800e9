"""A picture of a record and its fit, as an SVG file."""

from __future__ import annotations

from bench.records.response import Response
from bench.reporting.certificate.figures import SIZE, draw_record
from bench.reporting.inline_svg import RC, pyplot, svg_file


def fit_picture(response: Response) -> str:
    """The samples, the fitted response, and what is left of each sample. Raises ImportError without matplotlib."""
    plt = pyplot()
    fit = response.fit
    drawn = None if fit is None else ((fit.times, fit.values), fit.residuals.values)
    label = f"{response.measures} ({response.unit})"
    with plt.rc_context({**RC, "svg.fonttype": "path"}):  # its letters are the same wherever it is opened
        figure = plt.figure(figsize=(1.3 * SIZE[0], 1.3 * SIZE[1]), layout="constrained")
        draw_record(figure, (response.times, response.values), drawn, label, response.unit)
        said = response.method if fit is None else f"{response.method}: {response.trust.value}"
        figure.suptitle(said, x=0.99, ha="right")
        return svg_file(figure)
