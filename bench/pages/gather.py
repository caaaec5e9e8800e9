"""Stored cells by scenario: what was asked, of which system, and which experiments' tables show it."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from bench.errors import InputError
from bench.reference import REFERENCES
from bench.store import Store, StoredCell
from bench.tables import TITLES, table_experiments

DERIVED = ("natural_frequency", "damping_ratio")
"""Quantities that say the same as k/m and c/m once more; they are in the CSVs."""
ERROR = "_error_pct"
SIZES = {
    "integrator": "relative tolerance {:g}", "jitter": "{:g} of a step", "irregular": "",
    "coloured": "correlation {:g}", "heavy_tails": "{:g} degrees of freedom", "outliers": "{:g} × the noise",
    "bias": "{:g} of the signal’s rms", "drift": "{:g} of the signal’s rms at the end", "late_trigger": "{:g} s",
}  # fmt: skip
"""What the size of a disturbance is, by kind; of others the bare number is shown."""


def disturbed(kind: str, size: float) -> str:
    """A disturbance and its size with the unit."""
    said = "" if math.isnan(size) else SIZES.get(kind, "{:g}").format(size)
    return (f"{kind}, {said}" if said else kind).replace("_", " ")


def decibels(snr_db: float) -> str:
    """A signal-to-noise ratio to a tenth of a decibel."""
    return f"{round(snr_db, 1):g}"


@dataclass(frozen=True)
class Experiment:
    """An experiment that describes a table: its name in ``conf``, the table's number if any, its scenarios' keys."""

    name: str
    number: int | None
    scenarios: frozenset[str]

    @property
    def short(self) -> str:
        """The number of its table, else its name."""
        return self.name if self.number is None else str(self.number)

    @property
    def said(self) -> str:
        """``Table 3``, else the name."""
        return self.name if self.number is None else f"Table {self.number}"


@dataclass(frozen=True)
class Panel:
    """All that is stored of one scenario and seed: one cell a label, methods and reference rows alike."""

    cells: tuple[StoredCell, ...]
    experiments: tuple[Experiment, ...]

    @property
    def what(self) -> Mapping[str, Any]:
        """The description of the scenario: that of any cell of it."""
        return self.cells[0].cell

    @property
    def data(self) -> Mapping[str, Any]:
        found: Mapping[str, Any] = self.what.get("data", {})
        return found

    @property
    def system(self) -> str:
        return str(self.what.get("system") or self.data.get("system", "?"))

    @property
    def snr_db(self) -> float:
        value = self.what.get("snr_db", self.data.get("snr_db"))
        return math.nan if value is None else float(value)

    @property
    def told(self) -> str:
        """``known`` or ``unknown``: whether methods were told the initial state."""
        return str(self.what.get("initial_state") or self.what.get("told", {}).get("initial_state", "?"))

    @property
    def disturbance(self) -> str:
        """What breaks the assumptions; empty where nothing does."""
        found = self.data.get("disturbance") or {}
        return disturbed(str(found["kind"]), float(found.get("size", math.nan))) if "kind" in found else ""

    @property
    def prior(self) -> Mapping[str, Any] | None:
        found: Mapping[str, Any] | None = self.what.get("told", {}).get("prior")
        return found

    @property
    def kind(self) -> str:
        """What is special about its data, in a few words."""
        seed = self.what.get("seed")
        drawn = "truth drawn anew" if "truth" in self.data else ""
        parts = [self.disturbance, drawn, f"seed {seed}" if seed else ""]
        return ", ".join(part for part in parts if part) or "undisturbed"

    @property
    def plain(self) -> bool:
        """Neither disturbed nor with a truth of its own in each replicate."""
        return not self.disturbance and "truth" not in self.data

    @cached_property
    def methods(self) -> tuple[StoredCell, ...]:
        """The cells of methods; reference rows left out."""
        return tuple(cell for cell in self.cells if cell.cell.get("method") not in REFERENCES)

    @cached_property
    def metrics(self) -> tuple[str, ...]:
        """Errors of parameters and groups, and the displacement's, in the order in which the cells have them."""
        names = dict.fromkeys(name for cell in self.cells for name in cell.summary)
        errors = [n for n in names if n.endswith(ERROR) and not n.startswith(DERIVED)]
        return (*errors, *(["rmse"] if "rmse" in names else []))

    @cached_property
    def ranked(self) -> tuple[str, ...]:
        """The metrics that the data decide: what methods can be compared on. Groups first where parameters are not."""
        told = self.identifiable
        return tuple(name for name in self.metrics if name == "rmse" or told.get(name.removesuffix(ERROR), True))

    @cached_property
    def identifiable(self) -> Mapping[str, bool]:
        """By quantity, whether the data alone tell it."""
        return {name: told for cell in reversed(self.cells) for name, told in cell.identifiable.items()}

    @cached_property
    def prior_share(self) -> Mapping[str, float]:
        """By quantity, the prior's share of the variance at the bound."""
        return {name: share for cell in reversed(self.cells) for name, share in cell.prior_share.items()}

    def title(self) -> str:
        """One line for people."""
        special = "" if self.kind == "undisturbed" else f", {self.kind}"
        return f"{self.system}, {decibels(self.snr_db)} dB, start {self.told}{special}"


@dataclass(frozen=True)
class Gathered:
    """The store as the page needs it; ``hidden`` cells gave way to others of the same label and scenario.

    ``hidden``: how many times each such label and scenario is there, as text.
    """

    panels: tuple[Panel, ...]
    cells: tuple[StoredCell, ...]
    experiments: tuple[Experiment, ...]
    hidden: Mapping[str, int]


def gather(store: Store) -> Gathered:
    """Read a store; raises InputError where there is none, where it is empty, or for a file that is no cell."""
    if not store.there():
        raise InputError("store", store.folder, "there is no such folder; run some cells first")
    cells = tuple(store)
    if not cells:
        raise InputError(
            "store", store.folder, "no cell is stored there; run python -m bench -m experiment=table3 first"
        )
    grouped: dict[str, list[StoredCell]] = {}
    for cell in cells:
        grouped.setdefault(_stored_key(cell), []).append(cell)
    found = [one for one in map(_experiment, table_experiments()) if one.scenarios & set(grouped)]
    experiments = tuple(sorted(found, key=lambda one: (one.number is None, one.number or 0, one.name)))
    panels = [_panel(own, [one for one in experiments if key in one.scenarios]) for key, own in grouped.items()]
    panels.sort(key=_order(experiments))
    shown = {cell.identity for panel in panels for cell in panel.cells}
    hidden = Counter(
        f"{TITLES.get(label_of(c), label_of(c))} ({Panel((c,), ()).title()})" for c in cells if c.identity not in shown
    )
    return Gathered(tuple(panels), cells, experiments, hidden)


def _experiment(name: str) -> Experiment:
    """An experiment's scenarios, from its cells of one method a block: all methods of a block have the same."""
    from bench import config

    content = config._experiment(name)
    keys = set()
    for block in [{}, *content.get("also", [])]:
        sweep = {**content.get("sweep", {}), **block}
        sweep["method"] = sweep.get("method", ["oracle"])[:1]
        for job in config._expand_sweep(sweep, content, frozenset(), multirun=True):
            scenario = job.cell().scenario
            keys.add(_key(scenario.data_identity(), scenario.told_identity(), job.config.seed, scenario.label))
    number = content["table"].get("number")
    return Experiment(name, None if number is None else int(number), frozenset(keys))


def _stored_key(cell: StoredCell) -> str:
    what = cell.cell
    return _key(what.get("data"), what.get("told"), what.get("seed"), what.get("system"))


def _key(data: Any, told: Any, seed: Any, label: Any) -> str:
    """What is the same for all methods of one row of a table."""
    return json.dumps([data, told, seed, label], sort_keys=True, default=str)


def label_of(cell: StoredCell) -> str:
    """What tables call a cell's method."""
    return str(cell.cell.get("label") or cell.cell.get("method", "?"))


def _panel(cells: Sequence[StoredCell], experiments: Sequence[Experiment]) -> Panel:
    """Of several cells of a label, the one of most replicates."""
    kept: dict[str, StoredCell] = {}
    for cell in sorted(cells, key=lambda one: (-len(one.rows), one.identity)):
        kept.setdefault(label_of(cell), cell)
    shown = tuple(kept[label] for label in sorted(kept))
    return Panel(shown, tuple(experiments))


def _order(experiments: Sequence[Experiment]) -> Any:
    """Tables, other experiments, single cells; then by system, less noise first, start unknown first."""
    rank = {one.name: i for i, one in enumerate(experiments)}

    def key(panel: Panel) -> tuple[Any, ...]:
        places = [rank[one.name] for one in panel.experiments]
        rest = json.dumps([panel.data, panel.what.get("told")], sort_keys=True, default=str)
        first = min(places, default=len(rank))
        return (first, bool(panel.disturbance), panel.system, -panel.snr_db, panel.told != "unknown", rest)

    return key
