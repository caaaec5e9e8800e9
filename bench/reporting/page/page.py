"""``python -m bench.report [store=...] [out=results/report.html]``: the results as one page, without network.

From stored cells, their arrays and the files beside the page (tables, figures) alone; nothing is computed anew but
ranks. The same store gives the same bytes.
"""

from __future__ import annotations

import base64
import hashlib
import math
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

from bench.reporting.frame import Result
from bench.reporting.grid import rendered
from bench.reporting.labels import title
from bench.reporting.page import cards, headline, leaderboard, neighbours, origin
from bench.reporting.page.reading import Panel, Reading, decibels, read
from bench.reporting.page.typical import typical
from bench.reporting.page.words import heading, number, percent, quantity
from bench.store.store import Store

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


def chosen(reading: Reading, places: Sequence[int]) -> list[int]:
    """The scenarios that are shown in full: those of the first screen, then the typical one of every other system."""
    seen = {reading.panels[i].facts.system for i in places}
    others = [i for i in typical(reading.panels) if reading.panels[i].facts.system not in seen]
    return [*places, *others][:MOST_DRAWN]


def told(panel: Panel) -> tuple[tuple[str, str], ...]:
    """What the methods were told of a scenario, and what they were not."""
    facts = panel.facts
    duration = f"{facts.duration:g}" if math.isfinite(facts.duration) else None
    sigma = ", ".join(map(number, facts.sigma))
    lines = [
        ("Samples", f"{facts.samples or '?'} over {duration} s"),
        ("Initial state", "told" if facts.initial_state == "known" else "not told; estimated with the rest"),
        ("Force", f"{facts.force}; told" if facts.forced else "none: free vibration"),
        ("Prior", "none" if facts.prior is None else _prior(facts)),
        (
            "Noise",
            f"{decibels(facts.snr_db)} dB" + (f", standard deviation {sigma} m" if sigma else "") + "; not told",
        ),
    ]
    if facts.added_mass:
        added = ", ".join(f"{mass:g}" for mass in facts.added_mass)
        lines.append(("Second record", f"of the same rig with {added} kg added, told"))
    if panel.disturbance:
        lines.append(("Disturbance", f"{panel.disturbance}; not told"))
    true = ", ".join(f"{name} = {number(float(value))}" for name, value in facts.parameters.items())
    lines.append(("True values", f"{true} (SI units); told to nobody" if true else "not recorded"))
    return tuple(lines)


def _prior(facts: Result) -> str:
    """How far the nominal values may be off, by kind of parameter."""
    prior, system = facts.prior or {}, facts.known_model
    there = {parameter.kind for parameter in system.parameters} if system else set(KINDS)
    kinds = [f"{kind} {100 * float(prior[kind]):g} %" for kind in KINDS if kind in prior and kind in there]
    off = "; deliberately three standard deviations off" if prior.get("wrong") else ""
    return f"nominal values, off by about: {', '.join(kinds)}{off}"


def again(panel: Panel) -> str:
    """The command that computes a scenario again."""
    if panel.experiments:
        return f"python -m bench -m experiment={panel.experiments[0].name}"
    return f"python -m bench.reproduce {panel.facts.identity[:8]}"


def drawn(store: Store, reading: Reading, places: Sequence[int]) -> list[Drawn]:
    """The chosen scenarios with their pictures; without one only those of the first screen, which come first."""
    from bench.reporting.page.drawing import draw_panel

    found: list[Drawn] = []
    first = headline.headline_places(reading)
    for i in places:
        n, panel = len(found), reading.panels[i]
        picture, undrawn = draw_panel(store, panel, f"p{n}")
        if not picture and i not in first:
            continue
        found.append(Drawn(panel, f"scenario-{n}", picture, tuple(map(title, undrawn)), told(panel), again(panel)))
    return found


def contents(store: Store, out: Path) -> dict[str, Any]:
    """All that the template shows, figures apart; raises InputError for a store that cannot be shown."""
    from bench.reporting.page.drawing import draw_answers

    reading = read(store)
    ranked = leaderboard.rankings(reading)
    places = headline.headline_places(reading)
    results = out.parent
    panels = {i: reading.panels[i] for i in places}
    astray = headline.runaways(reading.panels, ranked)
    answers = [
        headline.answer(i, panel, ranked, neighbours.separated(results, panel.facts.initial_state), astray)
        for i, panel in panels.items()
    ]
    lines = leaderboard.leaderboard(reading, ranked)
    shown = cards.cards()
    full = drawn(store, reading, chosen(reading, places))
    snr = reading.panels[places[0]].facts.snr_db
    methods = {result.label: result.method for panel in reading.panels for result in panel.methods}
    return {
        "reading": reading,
        "answers": answers,
        "methods": len(methods),
        "variants": len(methods) > len(set(methods.values())),
        "stored": set(methods.values()),
        "absent": [title(label) for label in sorted(set(methods) - _labels(panels.values()))],
        "snr": f"{snr:g}",
        "noise": f"{100 * 10 ** (-snr / 20):.2g}" if math.isfinite(snr) else "",
        "hidden": headline.hidden(reading.panels[places[0]]),
        "overview": draw_answers(answers) if any(one.panel.methods for one in answers) else [],
        "n": max((result.n for panel in panels.values() for result in panel.methods), default=0),
        "leaderboard": lines,
        "filters": {
            name: leaderboard.options(lines.lines, name)
            for name in ("system", "snr", "start", "data", "method", "quantity")
        },
        "preset": _preset(reading, places),
        "drawn": full,
        "undrawn": len(reading.panels) - len(full),
        "shares": _shares(reading, places),
        "cards": shown,
        "named": sorted({w.name for one in answers for w in (*one.winners, *one.undecided)}, key=str.casefold),
        "about": cards.about(shown),
        "overall": neighbours.overall(results),
        "reproduction": neighbours.reproduction(results),
        "calibration": neighbours.calibration(results / "calibration.csv"),
        "sbc": neighbours.calibration(results / "sbc.csv"),
        "robustness": neighbours.robustness(results),
        "origin": origin.origin(reading.results),
        "failures": origin.failures(reading.results),
        "unsupported": origin.unsupported(reading.results),
        "experiments": ",".join(one.name for one in reading.experiments),
        "others": neighbours.files_beside(out, [*(OTHERS[0].format(n=n) for n in range(2, 20)), *OTHERS[1:]]),
    }


def _labels(panels: Iterable[Panel]) -> set[str]:
    """The methods and variants of some scenarios."""
    return {result.label for panel in panels for result in panel.methods}


def _preset(reading: Reading, places: Sequence[int]) -> dict[str, str]:
    """What the filters of the leaderboard are set to at first: the first screen's scenario and first quantity."""
    panel = reading.panels[places[0]]
    metric = panel.ranked[0] if panel.ranked else ""
    return {
        "system": panel.facts.system, "snr": decibels(panel.facts.snr_db), "start": panel.facts.initial_state,
        "data": panel.kind, "quantity": heading(metric) if metric else "",
    }  # fmt: skip


def _shares(reading: Reading, places: Sequence[int]) -> neighbours.Table:
    """By scenario and quantity, the prior's share of the variance at the bound: one scenario a system and start."""
    seen: dict[tuple[str, str], Panel] = {}
    order = [*places, *range(len(reading.panels))]
    for i in order:
        panel = reading.panels[i]
        if panel.plain and panel.prior_share:
            seen.setdefault((panel.facts.system, panel.facts.initial_state), panel)
    rows = []
    for panel in seen.values():
        for name, share in panel.prior_share.items():
            tells = {True: "the data", False: "not by the data alone"}.get(panel.identifiable.get(name, True), "")
            rows.append(
                (
                    panel.facts.system,
                    decibels(panel.facts.snr_db),
                    panel.facts.initial_state,
                    quantity(f"{name}_error_pct"),
                    percent(share),
                    tells,
                )
            )
    return neighbours.Table(("System", "SNR (dB)", "Start", "Quantity", "Prior's share", "Told by"), tuple(rows))


def render(context: Mapping[str, Any], figures: Sequence[neighbours.Figure]) -> str:
    """The page. Every text is escaped; the script runs by its digest and nothing else may load or run."""
    folder = files("bench.reporting.page")
    style = folder.joinpath("report.css").read_text(encoding="utf-8")
    script = folder.joinpath("report.js").read_text(encoding="utf-8")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    own = {"figures": figures, "style": style, "script": script, "script_digest": digest}
    return rendered("page/report.html.j2", **context, **own)


def page(store: Store, out: Path) -> str:
    """The page of a store, below :data:`LIMIT` bytes."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing from")  # the browser has fonts for other scripts
        context = contents(store, out)
    folder = out.parent / "figures"
    while True:
        linked = len(render(context, neighbours.figures(folder, out, 0)).encode())
        if linked <= LIMIT - ROOM or not any(one.picture for one in context["drawn"]):
            break
        kept = [one for one in context["drawn"] if one.picture]
        last = kept[-1]
        context["drawn"] = [one for one in context["drawn"] if one is not last]
        context["undrawn"] += 1
    return render(context, neighbours.figures(folder, out, LIMIT - linked - 1000))
