"""Figures over time: the paper's Figures 4, 5, 9 and 11, and the online track."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from textwrap import fill
from typing import Any

import altair as alt
import numpy as np
import pandas as pd

from bench.contract.problem import Channel, Record
from bench.dynamics.simulate import fit_initial_state, simulate
from bench.online.follow import Followed
from bench.online.scenario import Stream
from bench.reporting.frame import Result
from bench.reporting.labels import counterparts, title
from bench.reporting.paper import own_method
from bench.reporting.pictures.gallery import Arrays, Gallery, replicates, where
from bench.reporting.pictures.style import ONE, Nothing, Picture, layered, table
from bench.reporting.pictures.theme import HALF
from bench.reporting.rounding import readable
from bench.scoring.statistics import Z95

MILLI = 1000.0
POINTS = 200
"""Largest number of points of a curve."""
LINES = ("true response", "estimate", "samples")
"""Entries of the legend, in grey, blue and black."""


def over_time(frame: pd.DataFrame, up: str | None) -> Any:
    """Draw true response, bound, estimate with its interval, and samples, as far as the table has them.

    Args:
        frame: Columns ``time``; ``true`` with the bounds ``least`` and ``most``; ``estimate`` with ``low`` and
            ``high``; ``sample``.
        up: Title of the ordinate.
    """
    chart, x = alt.Chart(frame), alt.X("time:Q").title("time (s)").scale(nice=False)
    entries = [name for name, column in zip(LINES, ("true", "estimate", "sample"), strict=True) if column in frame]
    legend = alt.Legend(values=entries) if len(entries) > 1 else None
    hue = alt.Color("what:N").scale(domain=list(LINES), range="ordinal").legend(legend)

    def y(column: str) -> alt.Y:
        return alt.Y(f"{column}:Q").title(up).scale(zero=False)

    def there(column: str, what: str = "") -> Any:
        return chart.transform_filter(f"isValid(datum.{column})").transform_calculate(what=f"'{what}'")

    layers = {
        "least": lambda: there("least").mark_area(style="region").encode(x, y("least"), y2="most:Q"),
        "true": lambda: there("true", LINES[0]).mark_line(opacity=0.5, strokeWidth=2.5).encode(x, y("true"), hue),
        "low": lambda: there("low").mark_area(opacity=0.3).encode(x, y("low"), y2="high:Q"),
        "zero": lambda: alt.Chart(ONE).mark_rule(style="truth").encode(y=alt.datum(0)),
        "estimate": lambda: there("estimate", LINES[1]).mark_line().encode(x, y("estimate"), hue),
        "sample": lambda: there("sample", LINES[2]).mark_point(size=9, strokeWidth=0.7).encode(x, y("sample"), hue),
    }  # fmt: skip
    return layered(frame, *(layer() for column, layer in layers.items() if column in frame))


def panels(frame: pd.DataFrame, up: str | None, columns: int, height: float) -> Any:
    """Draw a panel for each value of the column ``panel``, in order of occurrence, each with its own limits."""
    facet = alt.Facet("panel:N").sort(list(dict.fromkeys(frame.panel)))
    layers = over_time(table(frame), up).properties(width=100, height=height)
    equal_lengths = frame.groupby("panel").time.max().nunique() == 1
    faceted = layers.facet(facet, columns=columns, spacing=8)
    return faceted.resolve_scale(x="shared" if equal_lengths else "independent", y="independent")


def curves(panel: str, times: np.ndarray, **values: np.ndarray) -> pd.DataFrame:
    """Return the lines of a panel, thinned."""
    return pd.DataFrame({"panel": panel, "time": times, **values})[:: max(1, -(-len(times) // POINTS))]


def samples(panel: str, arrays: Arrays, dof: int) -> pd.DataFrame:
    """Return the samples of a DOF."""
    times, values = samples_of(arrays, dof)
    return pd.DataFrame({"panel": panel, "time": times, "sample": values})


def samples_of(arrays: Arrays, dof: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the times (s) and values (m) of the samples of a DOF in the first record."""
    selected = arrays["sample_dof"] == dof
    return arrays["sample_times"][selected], arrays["sample_values"][selected]


def draw_record(gallery: Gallery) -> Picture:
    """Draw the samples of one replicate and the true response, one panel per sensor."""
    cell, arrays = gallery.recorded(gallery.scene(gallery.main))[0]
    dofs = sorted(set(arrays["sample_dof"].tolist()))
    frame = pd.concat(
        part
        for dof in dofs
        for name in [f"mass {dof + 1}" if len(dofs) > 1 else ""]
        for part in (curves(name, arrays["dense_times"], true=arrays["true_displacement"][dof]),
                     samples(name, arrays, dof))
    )  # fmt: skip
    return Picture(
        "record",
        panels(frame, "displacement (m)", 1, 110),
        f"The methods are given {np.sum(arrays['sample_dof'] == dofs[0])} noisy samples over {cell.duration:g} s. "
        f"Grey: true response, hidden from the methods ({where(cell)}; replicate 0). The noise level is constant, so "
        "the decayed part contains less information. The paper's Figure 4 shows the same.",
        HALF,
    )


def simulated(cell: Result, arrays: Arrays) -> np.ndarray | None:
    """Return the free response of the estimates, (n_dof, n_dense), which is scored without a reconstruction.

    The initial state is the known one, or fitted to the samples. None with a force, which is not stored.
    """
    ratios = {name: cell.first(f"{name}_ratio") for name in cell.parameters}
    if cell.forced or cell.added_mass or not all(map(math.isfinite, ratios.values())):
        return None
    parameters = {name: ratio * float(cell.parameters[name]) for name, ratio in ratios.items()}
    channels = tuple(Channel(*samples_of(arrays, dof), dof=dof) for dof in sorted(set(arrays["sample_dof"].tolist())))
    start = cell.known_initial_state or fit_initial_state(cell.model, parameters, Record(channels, (), None))
    return np.asarray(simulate(cell.model, parameters, start, arrays["dense_times"]).displacement)


def draw_reconstruction(gallery: Gallery) -> Picture:
    """Draw the displacement by the method of the paper, by the median method, and by the least accurate one."""
    drawn = list[tuple[Result, Arrays, np.ndarray]]()
    for cell, arrays in gallery.recorded(gallery.scene(gallery.main)):
        curve = arrays["displacement"] if "displacement" in arrays else simulated(cell, arrays)
        if curve is not None and math.isfinite(cell.first("rmse")):
            drawn.append((cell, arrays, curve))
    if not drawn:
        raise Nothing("no reconstruction is stored")
    drawn.sort(key=lambda entry: entry[0].first("rmse"))
    first = next((entry for entry in drawn if entry[0].label == own_method()), drawn[0])
    shown = {entry[0].label: entry for entry in (first, drawn[len(drawn) // 2], drawn[-1])}
    dof, parts = int(first[1]["sample_dof"][0]), []
    for cell, arrays, curve in shown.values():
        name = f"{fill(title(cell.label), 30)}\nRMSE {MILLI * cell.first('rmse'):.3g} mm"
        true = arrays["true_displacement"][dof]
        parts += [curves(name, arrays["dense_times"], true=true, estimate=curve[dof]), samples(name, arrays, dof)]
    far = sum(cell.first("rmse") > cell.sigma[0] for cell, *_ in drawn if cell.sigma)
    return Picture(
        "reconstruction",
        panels(pd.concat(parts), "displacement (m)", 3, 90),
        f"{len(drawn) - far} of {len(drawn)} methods have errors smaller than the noise of a sample. Responses from "
        f"the same record ({where(first[0])}; replicate 0): by the method of the paper, the median method, and the "
        "least accurate one, with the root mean square error over the record; for a method without a reconstruction, "
        "the response of its estimates. An error of k/m gives a phase error that grows with every cycle. The paper's "
        "Figure 5 shows this for its PINN alone.",
    )


def error_band(panel: str, arrays: Arrays, dof: int) -> pd.DataFrame:
    """Return estimate minus true response (mm), with the 95 % band of the method, if it states one."""
    error = MILLI * (arrays["displacement"][dof] - arrays["true_displacement"][dof])
    half = MILLI * Z95 * arrays["displacement_sd"][dof] if "displacement_sd" in arrays else np.full_like(error, np.nan)
    return curves(panel, arrays["dense_times"], estimate=error, low=error - half, high=error + half).assign(zero=0)


def draw_band(gallery: Gallery) -> Picture:
    """Draw the error of each reconstruction with its band, which should contain zero."""
    recorded = gallery.recorded(gallery.scene(gallery.main), "displacement_sd", "displacement")
    parts, shares = [], []
    for cell, arrays in recorded:
        inside, name = cell.successful("band_inside_95"), fill(title(cell.label), 30)
        if inside.size:
            shares.append(100.0 * float(inside.mean()))
            name += f"\n{shares[-1]:.0f} % inside (n = {inside.size})"
        parts.append(error_band(name, arrays, int(arrays["sample_dof"][0])))
    low, high = (f"{edge:.0f}" for edge in (min(shares, default=0.0), max(shares, default=0.0)))
    lead = f"95 % bands cover {low if low == high else f'{low} to {high}'} % of the true response."
    return Picture(
        "band",
        panels(pd.concat(parts), "estimate − true (mm)", 3, 90),
        f"{lead if shares else 'A band states the uncertainty of a reconstruction.'} One panel per method with a band "
        f"({where(recorded[0][0])}; replicate 0): its reconstruction minus the true response, and ±1.96 of its "
        "standard deviations. The percentage is the mean share of the record inside the band over "
        f"{replicates(cell for cell, _ in recorded)} replicates. The paper's Figure 9 shows such a band without its "
        "coverage.",
    )


def draw_two_masses(gallery: Gallery) -> Picture:
    """Draw identified and true response of every DOF, and the error with its band."""
    cells = gallery.scene(gallery.largest(cell for cell in gallery.cells if cell.n_dof > 1))
    recorded = gallery.recorded((cell for cell in cells if not cell.is_reference), "displacement")
    papers = counterparts(own_method())  # the method of the paper, else the first one
    cell, arrays = next((pair for label in papers for pair in recorded if pair[0].label == label), recorded[0])
    off, parts = arrays["displacement"] - arrays["true_displacement"], []
    for dof, (true, estimate) in enumerate(zip(arrays["true_displacement"], arrays["displacement"], strict=True)):
        name = f"mass {dof + 1}: displacement (m)"
        parts += [curves(name, arrays["dense_times"], true=true, estimate=estimate), samples(name, arrays, dof)]
        parts.append(error_band(f"mass {dof + 1}: estimate − true (mm)", arrays, dof))
    return Picture(
        "two_masses",
        panels(pd.concat(parts), None, 2, 80),
        f"{title(cell.label)} reconstructs the motion of {len(off)} masses with a root mean square error of "
        f"{MILLI * math.sqrt(np.mean(off**2)):.2g} mm. Left: estimated response, true response (grey) and samples "
        f"({where(cell)}; replicate 0). Right: estimate minus true response, with the 95 % band of the method. The "
        "paper's Figure 11 shows a simulated response of two masses without any identification.",
    )


@dataclass(frozen=True, eq=False)
class ShownTrack:
    """First replicate of a scenario: stream, bound, quantity, and the path and excess of each tracker by title."""

    scenario: str
    stream: Stream
    bound: Mapping[str, np.ndarray]
    quantity: str
    paths: Mapping[str, tuple[Followed, float]]

    @property
    def nearest(self) -> str:
        """Title of the tracker nearest to the bound, which is drawn."""
        return min(self.paths, key=lambda title: self.paths[title][1])


def draw_online(shown: Sequence[ShownTrack]) -> Picture:
    """Draw the changing quantity, the bound, and the tracker nearest to the bound, one panel per scenario."""
    first = [track.nearest for track in shown]
    leaders = [name for name in dict.fromkeys(first) if first.count(name) == max(map(first.count, first))]
    several = len(leaders) > 1
    return Picture(
        "online",
        panels(pd.concat(map(track_lines, shown)), None, 4, 60),
        f"{' and '.join(leaders)} {'are' if several else 'is'} most often nearest to the bound, in "
        f"{first.count(leaders[0])} of {len(shown)} scenarios{' each' if several else ''}. One record per scenario. "
        "Grey line: true ratio (SI units); grey region: 95 % range of an unbiased estimate at the bound; blue: the "
        "tracker nearest to the bound over all records, with its 95 % interval and its error over the bound. A curve "
        "begins with the first estimate of the tracker, and is clipped at the edges of the panel.",
    )


def track_lines(track: ShownTrack) -> pd.DataFrame:
    """Return the lines of a scenario's panel, clipped to limits from the true value and the later estimates."""
    quantities, times = track.stream.layout.quantities, track.stream.times
    i = [quantity.name for quantity in quantities].index(track.quantity)
    true = quantities[i].value(track.stream.truth.parameters) * np.ones(len(times))
    path, excess = track.paths[track.nearest]
    half, mean, sd = Z95 * np.sqrt(track.bound[track.quantity]), path.means[:, i], path.sds[:, i]
    lines = {"least": true * np.exp(-half), "most": true * np.exp(half), "estimate": np.exp(mean),
             "low": np.exp(mean - Z95 * sd), "high": np.exp(mean + Z95 * sd)}  # fmt: skip
    late = slice(len(times) // 4, None)
    ends = np.concatenate([true, lines["least"][late], lines["most"][late], lines["estimate"][late]])
    low, high = np.nanquantile(ends, [0.005, 0.995])
    room = 0.1 * (high - low)
    quantity = track.quantity.replace("_over_", "/")
    name = f"{fill(readable(track.scenario), 26)}\n{quantity}, {track.nearest} {excess:.2f}"
    kept = {column: np.clip(values, low - room, high + room) for column, values in lines.items()}
    return curves(name, times, true=true, **kept)
