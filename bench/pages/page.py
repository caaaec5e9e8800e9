"""``python -m bench.report [store=...] [out=results/report.html]``: the results as one page, without network.

From stored cells, their arrays and the files beside the page (tables, figures) alone; nothing is computed anew but
ranks. The same store gives the same bytes.
"""

from __future__ import annotations

import base64
import hashlib
import math
import os
import sys
import uuid
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

from bench.cli import read_fields
from bench.errors import InputError
from bench.pages import beside, board, cards, headline, origin
from bench.pages.gather import Gathered, Panel, decibels, gather, label_of
from bench.pages.kept import system_of
from bench.pages.typical import typical
from bench.pages.words import number, percent, quantity, title_of
from bench.store import Store
from bench.store_archive.opening import DEFAULT_STORE, open_store
from bench.terminal import command

LIMIT = 2_500_000
"""Bytes of the page at most: scenarios go without a picture, then figures are linked instead."""
ROOM = 500_000
"""Bytes of them that are kept for the figures."""
MOST_DRAWN = 20
KINDS = ("mass", "damping", "stiffness", "other")
OTHERS = ("table{n}.md", "leaderboard.md", "reproduction.md", "calibration.md", "sbc.md", "robustness.md", "pinn.md")


@dataclass(frozen=True)
class Drawn:
    """A scenario with its picture; ``undrawn`` are the methods without a fit to draw."""

    panel: Panel
    name: str
    picture: str
    undrawn: tuple[str, ...]
    told: tuple[tuple[str, str], ...]
    again: str


def chosen(gathered: Gathered, places: Sequence[int]) -> list[int]:
    """The scenarios that are shown in full: those of the first screen, then the typical one of every other system."""
    seen = {gathered.panels[i].system for i in places}
    others = [i for i in typical(gathered.panels) if gathered.panels[i].system not in seen]
    return [*places, *others][:MOST_DRAWN]


def told(panel: Panel) -> tuple[tuple[str, str], ...]:
    """What the methods were told of a scenario, and what they were not."""
    data, prior = panel.data, panel.prior
    start = "told" if panel.told == "known" else "not told; estimated with the rest"
    duration = data.get("duration")
    lines = [
        ("Samples", f"{data.get('samples', '?')} over {duration if duration is None else f'{duration:g}'} s"),
        ("Initial state", start),
        ("Force", "none: free vibration" if data.get("force") is None else _force(data["force"])),
        ("Prior", "none" if prior is None else _prior(panel)),
    ]
    sigma = ", ".join(number(float(s)) for s in panel.what.get("sigma") or ())
    lines.append(
        ("Noise", f"{decibels(panel.snr_db)} dB" + (f", standard deviation {sigma} m" if sigma else "") + "; not told")
    )
    if data.get("added_mass"):
        added = ", ".join(f"{float(mass):g}" for mass in data["added_mass"])
        lines.append(("Second record", f"of the same rig with {added} kg added, told"))
    if panel.disturbance:
        lines.append(("Disturbance", f"{panel.disturbance}; not told"))
    true = ", ".join(f"{name} = {number(float(value))}" for name, value in data.get("parameters", {}).items())
    lines.append(("True values", f"{true} (SI units); told to nobody" if true else "not recorded"))
    return tuple(lines)


def _force(force: Mapping[str, Any]) -> str:
    """What is known of a force: a stored description names every kind but the default."""
    kind = str(force.get("kind", "multisine")).replace("_", " ")
    size = f", amplitude {float(force['amplitude']):g} N" if "amplitude" in force else ""
    return f"{kind}{size}; told"


def _prior(panel: Panel) -> str:
    """How far the nominal values may be off, by kind of parameter."""
    prior, system = panel.prior or {}, system_of(panel.cells[0])
    there = {parameter.kind for parameter in system.parameters} if system else set(KINDS)
    kinds = [f"{kind} {100 * float(prior[kind]):g} %" for kind in KINDS if kind in prior and kind in there]
    off = "; deliberately three standard deviations off" if prior.get("wrong") else ""
    return f"nominal values, off by about: {', '.join(kinds)}{off}"


def again(panel: Panel) -> str:
    """The command that computes a scenario again."""
    if panel.experiments:
        return f"python -m bench -m experiment={panel.experiments[0].name}"
    return f"python -m bench.reproduce {panel.cells[0].identity[:8]}"


def drawn(store: Store, gathered: Gathered, places: Sequence[int]) -> list[Drawn]:
    """The chosen scenarios with their pictures; without one only those of the first screen, which come first."""
    from bench.pages.draw import draw_panel

    found: list[Drawn] = []
    first = headline.headline_places(gathered)
    for i in places:
        n, panel = len(found), gathered.panels[i]
        picture, undrawn = draw_panel(store, panel, f"p{n}")
        if not picture and i not in first:
            continue
        found.append(Drawn(panel, f"scenario-{n}", picture, tuple(map(title_of, undrawn)), told(panel), again(panel)))
    return found


def contents(store: Store, out: Path) -> dict[str, Any]:
    """All that the template shows, figures apart; raises InputError for a store that cannot be shown."""
    from bench.pages.draw import draw_answers

    gathered = gather(store)
    ranked = board.rankings(gathered)
    places = headline.headline_places(gathered)
    results = out.parent
    panels = {i: gathered.panels[i] for i in places}
    answers = [headline.answer(i, panel, ranked, beside.separated(results, panel.told)) for i, panel in panels.items()]
    lines = board.board(gathered, ranked)
    shown = cards.cards()
    full = drawn(store, gathered, chosen(gathered, places))
    snr = gathered.panels[places[0]].snr_db
    methods = {label_of(cell): cell.cell.get("method") for panel in gathered.panels for cell in panel.methods}
    return {
        "gathered": gathered,
        "answers": answers,
        "methods": len(methods),
        "variants": len(methods) > len(set(methods.values())),
        "stored": set(methods.values()),
        "absent": [title_of(label) for label in sorted(set(methods) - _labels(panels.values()))],
        "snr": f"{snr:g}",
        "noise": f"{100 * 10 ** (-snr / 20):.2g}" if math.isfinite(snr) else "",
        "hidden": headline.hidden(gathered.panels[places[0]]),
        "overview": draw_answers(answers) if any(one.panel.methods for one in answers) else [],
        "n": max((len(cell.rows) for panel in panels.values() for cell in panel.methods), default=0),
        "board": lines,
        "filters": {
            name: board.options(lines.lines, name) for name in ("system", "snr", "start", "data", "method", "quantity")
        },
        "preset": _preset(gathered, places),
        "drawn": full,
        "undrawn": len(gathered.panels) - len(full),
        "shares": _shares(gathered, places),
        "cards": shown,
        "named": sorted({w.name for one in answers for w in (*one.winners, *one.undecided)}, key=str.casefold),
        "about": cards.about(shown),
        "overall": beside.overall(results),
        "reproduction": beside.reproduction(results),
        "calibration": beside.calibration(results / "calibration.csv"),
        "sbc": beside.calibration(results / "sbc.csv"),
        "robustness": beside.robustness(results),
        "origin": origin.origin(gathered.cells),
        "failures": origin.failures(gathered.cells),
        "unsupported": origin.unsupported(gathered.cells),
        "experiments": ",".join(one.name for one in gathered.experiments),
        "others": beside.fits_beside(out, [*(OTHERS[0].format(n=n) for n in range(2, 20)), *OTHERS[1:]]),
    }


def _labels(panels: Iterable[Panel]) -> set[str]:
    """The methods and variants of some scenarios."""
    return {label_of(cell) for panel in panels for cell in panel.methods}


def _preset(gathered: Gathered, places: Sequence[int]) -> dict[str, str]:
    """What the filters of the leaderboard are set to at first: the first screen's scenario and first quantity."""
    from bench.pages.words import heading

    panel = gathered.panels[places[0]]
    metric = panel.ranked[0] if panel.ranked else ""
    return {
        "system": panel.system, "snr": decibels(panel.snr_db), "start": panel.told, "data": panel.kind,
        "quantity": heading(metric) if metric else "",
    }  # fmt: skip


def _shares(gathered: Gathered, places: Sequence[int]) -> beside.Table:
    """By scenario and quantity, the prior's share of the variance at the bound: one scenario a system and start."""
    seen: dict[tuple[str, str], Panel] = {}
    order = [*places, *range(len(gathered.panels))]
    for i in order:
        panel = gathered.panels[i]
        if panel.plain and panel.prior_share:
            seen.setdefault((panel.system, panel.told), panel)
    rows = []
    for panel in seen.values():
        for name, share in panel.prior_share.items():
            tells = {True: "the data", False: "not by the data alone"}.get(panel.identifiable.get(name, True), "")
            rows.append(
                (panel.system, decibels(panel.snr_db), panel.told, quantity(f"{name}_error_pct"), percent(share), tells)
            )
    return beside.Table(("System", "SNR (dB)", "Start", "Quantity", "Prior's share", "Told by"), tuple(rows))


def render(context: Mapping[str, Any], figures: Sequence[beside.Figure]) -> str:
    """The page. Every text is escaped; the script runs by its digest and nothing else may load or run."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    folder = files("bench.pages")
    style = folder.joinpath("report.css").read_text(encoding="utf-8")
    script = folder.joinpath("report.js").read_text(encoding="utf-8")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    environment = Environment(
        loader=PackageLoader("bench.pages", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    template = environment.get_template("report.html.j2")
    return template.render(**context, figures=figures, style=style, script=script, script_digest=digest) + "\n"


def page(store: Store, out: Path) -> str:
    """The page of a store, below :data:`LIMIT` bytes."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing from")  # the browser has fonts for other scripts
        context = contents(store, out)
    folder = out.parent / "figures"
    while True:
        linked = len(render(context, beside.figures(folder, out, 0)).encode())
        if linked <= LIMIT - ROOM or not any(one.picture for one in context["drawn"]):
            break
        kept = [one for one in context["drawn"] if one.picture]
        last = kept[-1]
        context["drawn"] = [one for one in context["drawn"] if one is not last]
        context["undrawn"] += 1
    return render(context, beside.figures(folder, out, LIMIT - linked - 1000))


def write(path: Path, text: str) -> None:
    """Write a page in one step; raises InputError where that cannot be done."""
    temporary = path.with_name(f"{path.name}.{uuid.uuid4().hex}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_text(text, encoding="utf-8", newline="\n")
        os.replace(temporary, path)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise InputError("out", path, f"cannot be written ({error.strerror}); name another file") from None


def main(argv: Sequence[str] | None = None) -> int:
    """Write the page; exit status 2 for bad input."""
    usage = f"usage: python -m bench.report [store={DEFAULT_STORE}] [archive=<folder>|none] [out=results/report.html]"
    return command("bench.report", f"{usage}\n\n{__doc__}", argv, _main)


def _main(arguments: Sequence[str]) -> int:
    try:
        fields = read_fields(arguments, {"store": DEFAULT_STORE, "archive": "", "out": "results/report.html"})
        out = Path(fields["out"])
        write(out, page(open_store(fields["store"], fields["archive"]), out))
        print(out)
    except ImportError as error:
        print(f"bench.report: {error.name} is missing: pip install 'vibration-bench[report]'", file=sys.stderr)
        return 2
    return 0
