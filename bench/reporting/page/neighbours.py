"""What lies beside the page already: the tables of other commands as CSV, and the figures as SVG."""

from __future__ import annotations

import itertools
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

import pandas as pd

from bench.reporting.labels import title
from bench.reporting.page.reading import disturbed
from bench.reporting.page.words import number, percent, quantity
from bench.scoring.verdict import decided


@dataclass(frozen=True)
class Table:
    """A table as text; ``notes`` are paragraphs above it, ``groups`` heads over several columns and how many."""

    headers: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()
    groups: tuple[tuple[str, int], ...] = ()


@dataclass(frozen=True)
class Figure:
    """A figure: inlined as ``source``, a data URI, or where that is empty only linked by ``href``."""

    name: str
    caption: str
    source: str
    href: str


def read_csv(path: Path) -> pd.DataFrame | None:
    """A CSV of this benchmark; None where there is none that can be read."""
    try:
        return pd.read_csv(path, keep_default_na=True)
    except (OSError, ValueError):
        return None


def reproduction(folder: Path) -> Table | None:
    """The verdicts on the paper's numbers: how many of each, then all of them."""
    data = read_csv(folder / "reproduction.csv")
    first = "as in the protocol"
    needed = {"table", "row", "method", "metric", "paper", first, f"{first}: median", "firm"}
    if data is None or not needed <= set(data.columns) or data.empty:
        return None
    counts = data[first].astype(str).str.replace(r" \(\d+ % prior\)", "", regex=True).value_counts()
    firm = int((data["firm"].astype(str) == "True").sum())
    known = int(data[first].astype(str).map(decided).sum())
    notes = [
        "; ".join(
            f"{n} of {len(data)}: {text}" for text, n in sorted(counts.items(), key=lambda pair: (-pair[1], pair[0]))
        )
        + ".",
        f"{firm} of the {known} verdicts that decide anything hold under every reading of what the paper leaves open.",
    ]
    rows = tuple(
        (
            str(line["table"]), str(line["row"]), title(str(line["method"])), quantity(str(line["metric"])),
            number(line["paper"]), number(line[f"{first}: median"]), str(line[first]),
            "yes" if str(line["firm"]) == "True" else "no" if decided(str(line[first])) else "-",
        )
        for _, line in data.iterrows()
    )  # fmt: skip
    headers = ("Table", "Row", "Method", "Error of", "Paper", "Ours, median", "Verdict", "Firm")
    return Table(headers, rows, tuple(notes))


def calibration(path: Path) -> Table | None:
    """How often the stated 95 % intervals hold the truth."""
    data = read_csv(path)
    needed = {"method", "initial_state", "snr_db", "quantity", "n", "coverage_95", "low_95", "high_95", "verdict"}
    if data is None or not needed <= set(data.columns) or data.empty:
        return None
    good = int((data["verdict"] == "calibrated").sum())
    rows = tuple(
        (
            title(str(line["method"])), str(line["initial_state"]), f"{line['snr_db']:g}",
            quantity(str(line["quantity"])), percent(line["coverage_95"]),
            f"{percent(line['low_95'])} to {percent(line['high_95'])}", f"{line['n']:.0f}", str(line["verdict"]),
        )
        for _, line in data.iterrows()
    )  # fmt: skip
    headers = (
        "Method",
        "Start",
        "SNR (dB)",
        "Quantity",
        "Truth inside",
        "95 % interval of that",
        "Data sets",
        "Verdict",
    )
    judged = int((data["verdict"] != "-").sum())
    note = (
        f"{good} of the {judged} lines below that state an uncertainty are calibrated, by three tests at 5 %, adjusted "
        "over all lines (Benjamini and Hochberg)."
    )
    return Table(headers, rows, (note,))


def robustness(folder: Path) -> Table | None:
    """Error over the bound by method and disturbance, of the first quantity of the file."""
    data = read_csv(folder / "robustness.csv")
    needed = {"disturbance", "initial_state", "size", "method", "metric", "excess", "ratio_low", "ratio_high"}
    needed |= {"n_ok", "n"}
    if data is None or not needed <= set(data.columns) or data.empty:
        return None
    data = data[data["metric"] == data["metric"].iloc[0]]
    lines = zip(data["disturbance"], data["size"], data["initial_state"], strict=True)
    columns = {(kind, told): disturbed(kind, size) for kind, size, told in lines}
    rows = []
    for method in dict.fromkeys(data["method"]):
        own = data[data["method"] == method]
        cells = []
        for disturbance, told in columns:
            line = own[(own["disturbance"] == disturbance) & (own["initial_state"] == told)]
            cells.append(_disturbed(line.iloc[0]) if len(line) else "–")
        low, high = int(own["n"].min()), int(own["n"].max())
        rows.append((title(str(method)), str(low) if low == high else f"{low} to {high}", *cells))
    names = ["undisturbed" if kind == "none" else name for (kind, _), name in columns.items()]
    groups = tuple((f"start {told}", len(list(own))) for told, own in itertools.groupby(told for _, told in columns))
    notes = (
        f"Root mean square error of {quantity(str(data['metric'].iloc[0]))} over the bound of the undisturbed data "
        "(of irregular times: their own), on the number of data sets given; the leaderboard may have more of the "
        "undisturbed ones, and so other values. A star: it differs from the undisturbed value by more than chance "
        "(95 %).",
    )
    return Table(("Method", "Data sets", *names), tuple(rows), notes, (("", 2), *groups))


def _disturbed(line: pd.Series) -> str:
    n_ok, n, excess = int(line["n_ok"]), int(line["n"]), float(line["excess"])
    star = " *" if line["ratio_low"] > 1.0 or line["ratio_high"] < 1.0 else ""
    failed = f" ({n_ok}/{n} ok)" if n_ok < n else ""
    return f"{number(excess)}{star}{failed}"


def separated(folder: Path, told: str) -> frozenset[str]:
    """The methods that the table over all scenarios finds behind the best in any quantity, for a reading of the start.

    Read as in the leaderboard, whose tests have more data than those of one scenario.
    """
    data = read_csv(folder / "leaderboard.csv")
    if data is None or not {"initial_state", "method", "tie"} <= set(data.columns):
        return frozenset()
    return frozenset(data[(data["initial_state"] == told) & (data["tie"].astype(str) == "False")]["method"])


def overall(folder: Path) -> Table | None:
    """The leaderboard over all scenarios of the tables, start unknown."""
    data = read_csv(folder / "leaderboard.csv")
    needed = {"initial_state", "metric", "method", "ratio", "low", "high", "tie"}
    if data is None or not needed <= set(data.columns) or data.empty:
        return None
    rows = tuple(
        (
            str(line["initial_state"]), quantity(str(line["metric"])), title(str(line["method"])),
            f"×{number(line['ratio'])}{_between(line)}",
            "level" if str(line["tie"]) == "True" else "behind",
        )
        for _, line in data.iterrows()
    )  # fmt: skip
    return Table(("Start", "Quantity", "Method", "Error over the best's (95 %)", "Standing"), rows)


def _between(line: pd.Series) -> str:
    return "" if pd.isna(line["low"]) else f" ({number(line['low'])} to {number(line['high'])})"


def figures(folder: Path, out: Path, room: int) -> list[Figure]:
    """The SVGs of a folder with their captions, in order of name; inlined while there is ``room`` (bytes)."""
    found = []
    for path in sorted(folder.glob("*.svg")) if folder.is_dir() else []:
        try:
            source = _data_uri(path.read_text(encoding="utf-8"))
            caption_file = path.with_suffix(".txt")
            caption = caption_file.read_text(encoding="utf-8").strip() if caption_file.is_file() else ""
        except (OSError, ValueError):
            continue
        href = quote(Path(os.path.relpath(path, out.parent)).as_posix())
        inline = len(source) <= room
        room -= len(source) if inline else 0
        found.append(Figure(path.stem, caption or path.stem.replace("_", " "), source if inline else "", href))
    return found


def _data_uri(text: str) -> str:
    """An SVG as an image source: apart from the page, so that its names and styles do not meet those of others."""
    from markupsafe import Markup  # comes with jinja2, which only the page needs

    text = text[text.find("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>|<!--.*?-->", "", text, flags=re.S)
    text = re.sub(r' d="[^"]*"', lambda m: re.sub(r"(\d\.\d\d)\d+", r"\1", m.group(0)), text)
    text = re.sub(r'( [xy]="-?\d+\.\d\d)\d+"', r'\1"', text)
    text = re.sub(r"\s*\n\s*", " ", text).replace("> <", "><").replace('"', "'")
    # no quotation mark and no bracket is left in it, so that it stands in an attribute as it is, and at its length
    return Markup("data:image/svg+xml," + quote(text, safe=" '=:;,/()+-.!*@$?_~"))


def files_beside(out: Path, names: Sequence[str]) -> list[str]:
    """Those of the files that lie beside the page, for links."""
    return [name for name in names if (out.parent / name).is_file()]
