"""The read model: stored cells, and cells that an experiment describes, as all tables, figures and pages read them.

A :class:`Result` is one cell, run or not, with the facts of its scenario and what came out; it alone knows the keys of
a stored description. A :class:`Frame` is the results of one experiment; those of a store are a plain list.
"""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import Any, TypeVar

import numpy as np

from bench.config.choices import choices
from bench.config.experiment import Experiment
from bench.config.random_scenarios import drawn_scenarios
from bench.contract.estimate import Status
from bench.contract.problem import InitialState
from bench.entrants.reference import REFERENCES
from bench.errors import InputError
from bench.reporting.labels import cards, title
from bench.scenario.scenario import Scenario
from bench.scoring.statistics import wilson_interval
from bench.store.cell import Cell, stored_as_cell
from bench.store.store import Store
from bench.store.stored import MARK, SUBMITTED, CellHead, StoredCell
from bench.store.version import settings_version
from bench.systems import System, make_system

ERROR = "_error_pct"
Line = Mapping[str, Any]
"""A line of a tidy table: its values by column."""
Item = TypeVar("Item")
Key = TypeVar("Key", bound=Hashable)


@dataclass(frozen=True, eq=False)
class Result:
    """One cell: the facts of its scenario, and what the store holds of it (None where it was not run).

    Arrays by replicate have the shape (n,).

    Attributes:
        system: What tables call the system.
        kind: The registered system whose equations it has.
        prior: The widths of the prior, by kind of parameter.
        data: What decides the data of a replicate.
        parameters: The true values (SI units).
        disturbance: The kind of what disturbs the data; empty where nothing does.
        duration: Of the record (s).
        samples: Of a sensor; 0 where the description does not say.
        n_dof: Masses that move; 0 where the description does not say.
        added_mass: Known masses (kg, one a DOF) of a second record; none where there is one record.
        truth_drawn: Whether each replicate has a truth of its own.
        cell: There where an experiment describes the cell.
    """

    label: str
    method: str
    system: str
    kind: str
    snr_db: float
    initial_state: str
    seed: int
    prior: Mapping[str, Any] | None
    settings: Mapping[str, Any]
    sigma: tuple[float, ...]
    data: Mapping[str, Any]
    parameters: Mapping[str, float]
    disturbance: str
    disturbance_size: float
    forced: bool
    duration: float
    samples: int
    n_dof: int
    added_mass: tuple[float, ...]
    truth_drawn: bool
    stored: StoredCell | None
    cell: Cell | None = None
    _columns: dict[str, np.ndarray] = field(default_factory=dict, repr=False)

    @classmethod
    def of_description(cls, what: Mapping[str, Any], stored: StoredCell | None, cell: Cell | None = None) -> Result:
        """The facts of a description as cells are stored with it; what a foreign one lacks is left open."""
        data, told, method = what.get("data", {}), what.get("told", {}), str(what.get("method", "?"))
        disturbance, kind = data.get("disturbance") or {}, str(data.get("system", "?"))
        snr = what.get("snr_db", data.get("snr_db"))
        return cls(
            label=str(what.get("label") or method),
            method=method,
            system=str(what.get("system") or kind),
            kind=kind,
            snr_db=math.nan if snr is None else float(snr),
            initial_state=str(what.get("initial_state") or told.get("initial_state", "?")),
            seed=int(what.get("seed") or 0),
            prior=told.get("prior"),
            settings=what.get("settings", {}),
            sigma=tuple(map(float, what.get("sigma") or ())),
            data=data,
            parameters=data.get("parameters", {}),
            disturbance=str(disturbance.get("kind", "")).removeprefix("none"),
            disturbance_size=float(disturbance.get("size", math.nan)),
            forced=bool(data.get("force")),
            duration=float(data.get("duration", math.nan)),
            samples=int(data.get("samples", 0)),
            n_dof=len(data.get("initial", [[]])[0]),
            added_mass=tuple(map(float, data.get("added_mass") or ())),
            truth_drawn="truth" in data,
            stored=stored,
            cell=cell,
        )

    @classmethod
    def of_cell(cls, cell: Cell, stored: StoredCell | None) -> Result:
        """A cell of an experiment, with what the store holds of it."""
        scenario = cell.scenario
        what = {"label": cell.label, "system": scenario.label, "snr_db": scenario.snr_db}
        return cls.of_description({**cell.description(), **what}, stored, cell)

    @classmethod
    def of_stored(cls, stored: StoredCell) -> Result:
        """A stored cell."""
        return cls.of_description(stored.cell, stored)

    # ---- facts of the scenario

    @property
    def force(self) -> str:
        """The known force in words: its shape, and its amplitude where that is stored; empty in free vibration."""
        force = self.data.get("force") or {}
        # a stored description names every shape but the default
        shape = str(force.get("kind", "multisine")).replace("_", " ") if force else ""
        return shape + (f", amplitude {float(force['amplitude']):g} N" if "amplitude" in force else "")

    @property
    def start_told(self) -> InitialState | None:
        """The initial state, where the methods were told it."""
        if self.initial_state != "known" or "initial" not in self.data:
            return None
        displacement, velocity = self.data["initial"]
        return InitialState(np.array(displacement, float), np.array(velocity, float))

    @cached_property
    def question(self) -> str:
        """What is the same for all methods that were asked the same: data, what is told, and seed."""
        told = {"initial_state": self.initial_state, "prior": self.prior}
        return json.dumps([self.data, told, self.seed, self.system], sort_keys=True, default=str)

    @cached_property
    def series(self) -> str:
        """What is the same for all cells that differ in method, noise level and start alone."""
        data = {key: value for key, value in self.data.items() if key != "snr_db"}
        return json.dumps({"data": data, "prior": self.prior, "seed": self.seed}, sort_keys=True)

    @cached_property
    def model(self) -> System:
        """The system whose equations the methods were given; raises InputError where it is not registered here."""
        return make_system(self.kind, self.data.get("options", {}))

    @property
    def known_model(self) -> System | None:
        """The same; None where it is not registered here."""
        with contextlib.suppress(InputError):
            return self.model
        return None

    @property
    def scenario(self) -> Scenario:
        """The scenario of an experiment's cell."""
        assert self.cell is not None, "a stored description alone makes no scenario"
        return self.cell.scenario

    @property
    def identity(self) -> str:
        """What names the cell in a store."""
        return self.stored.identity if self.stored else self.cell.identity if self.cell else ""

    @property
    def is_reference(self) -> bool:
        """Whether it is a reference row, which sees the truth or no data, and competes with nobody."""
        return self.method in REFERENCES

    @property
    def title(self) -> str:
        """The method's name for people."""
        return title(self.label)

    # ---- what came out

    @property
    def n(self) -> int:
        """Replicates that are stored."""
        return len(self.stored.columns) if self.stored else 0

    @cached_property
    def statuses(self) -> tuple[Status, ...]:
        return self.stored.columns.statuses if self.stored else ()

    @cached_property
    def ok(self) -> np.ndarray:
        """Which replicates succeeded, booleans (n,)."""
        return np.array([status is Status.OK for status in self.statuses], bool)

    @cached_property
    def n_ok(self) -> int:
        return int(self.ok.sum())

    @property
    def state(self) -> str:
        """``current``, ``stale`` where other versions computed an experiment's cell, or ``missing``."""
        if self.cell is None or self.stored is None:
            return "missing" if self.stored is None else ""
        return "current" if self.cell.version.is_that_of(self.stored.version) else "stale"

    @property
    def status(self) -> Status:
        """``ok`` where any replicate succeeded, else the most frequent failure."""
        assert self.stored is not None
        return self.stored.status

    @property
    def verification(self) -> str:
        """What was verified of a submitted cell when it was merged, in words; empty for one's own."""
        facts = self.stored.provenance.get(SUBMITTED) if self.stored else None
        if facts is None:
            return ""
        compared, rows, missed = (facts.get(name) for name in ("rows_compared", "of_rows", "missed_5_percent"))
        if not (isinstance(compared, int) and isinstance(rows, int)):  # a store is data, and may state anything
            return "submitted; what was verified of it is not stated"
        said = f"submitted; {compared} of its {rows} rows were computed again when it was merged, and came out the same"
        if not isinstance(missed, float):
            return said
        return f"{said} (a change of 5 % of the rows is missed with probability {missed:.2g})"

    @property
    def summary(self) -> Mapping[str, Mapping[str, float]]:
        """By metric, the stored statistics over the replicates."""
        return self.stored.summary if self.stored else {}

    @property
    def identifiable(self) -> Mapping[str, bool]:
        """By quantity, whether the data alone tell it."""
        return self.stored.identifiable if self.stored else {}

    @property
    def prior_share(self) -> Mapping[str, float]:
        """By quantity, the prior's share of the variance at the bound."""
        return self.stored.prior_share if self.stored else {}

    def statistic(self, metric: str, name: str) -> float:
        """``mean``, ``median``, ``ci_low``, ``ci_high``, ``bound`` or ``excess`` of a metric; NaN without it."""
        return float(self.summary.get(metric, {}).get(name, math.nan))

    def bound(self, metric: str) -> float:
        """The Cramér-Rao bound on the root mean square of a metric."""
        return self.statistic(metric, "bound")

    def excess(self, metric: str) -> float:
        """Root mean square of the successful replicates over the bound."""
        return self.statistic(metric, "excess")

    def coverage(self, quantity: str, level: int = 95) -> tuple[float, float, float]:
        """The share of the intervals of successful replicates that held the truth, with its 95 % interval."""
        return share(self.successful(f"{quantity}_coverage_{level}"))

    def scores(self, name: str) -> np.ndarray:
        """A score by replicate (n,), NaN where a replicate has none."""
        if name not in self._columns:
            self._columns[name] = self.stored.columns.scores(name) if self.stored else np.empty(0)
        return self._columns[name]

    def errors(self, metric: str) -> np.ndarray:
        """A metric's errors by replicate (n,), infinite where a replicate failed."""
        values = self.scores(metric)
        return np.where(np.isnan(values), math.inf, values)

    def successful(self, name: str, n: int | None = None) -> np.ndarray:
        """The finite scores of the replicates that succeeded, of the first ``n`` alone where given, (at most n,)."""
        values = self.scores(name)[:n]
        return np.asarray(values[self.ok[:n] & np.isfinite(values)])

    def first(self, name: str) -> float:
        """The score of replicate 0, the one whose arrays are kept."""
        return float(self.scores(name)[0]) if self.n else math.nan

    @cached_property
    def cpu_s(self) -> np.ndarray:
        """Processor time of each fit (s)."""
        return self.stored.columns.numbers("cpu_s") if self.stored else np.empty(0)

    @property
    def messages(self) -> Sequence[str]:
        """The message of each replicate."""
        return self.stored.columns.plain("message") if self.stored else ()

    def arrays(self) -> dict[str, np.ndarray]:
        """The arrays kept of replicate 0, as double precision; none where they are missing or damaged."""
        if self.stored:
            with contextlib.suppress(InputError):
                kept = self.stored.arrays.items()
                return {name: a.astype(float) if a.dtype.kind == "f" else a for name, a in kept}
        return {}


@dataclass(frozen=True, eq=False)
class Frame:
    """The results of an experiment that describes a table, in its order."""

    experiment: str
    title: str
    table: Mapping[str, Any]
    results: tuple[Result, ...]

    def __iter__(self) -> Iterator[Result]:
        return iter(self.results)

    @property
    def number(self) -> int | None:
        """The number of its table, if it has one."""
        return int(self.table["number"]) if self.table.get("number") else None

    @property
    def name(self) -> str:
        """What the files of its table are called."""
        return f"table{self.number}" if self.number else self.experiment

    @property
    def form(self) -> str:
        """What its table looks like."""
        return str(self.table.get("form", "paper"))

    @property
    def command(self) -> str:
        """What makes the table again."""
        return f"python -m bench -m experiment={self.experiment} && python -m bench tables"

    @property
    def footer(self) -> str:
        """The last line of its page: when the fits were computed, and what makes the table again."""
        return f"{computed(self)}Regenerate: `{self.command}`"


def computed(results: Iterable[Result]) -> str:
    """The first and the last day (UTC) on which results were computed, as a sentence; empty where none is dated."""
    starts = [str(result.stored.provenance.get("started") or "")[:10] for result in results if result.stored]
    days = sorted({start for start in starts if start})
    return f"Computed {' to '.join(dict.fromkeys((days[0], days[-1])))}. " if days else ""


def quantity(metric: str) -> str:
    """The quantity of which a metric is the error."""
    return metric.removesuffix(ERROR)


def share(hits: np.ndarray) -> tuple[float, float, float]:
    """The share of hits (n,), ones and zeros, with its 95 % interval (Wilson's); NaNs of none."""
    return (float(hits.mean()), *wilson_interval(int(hits.sum()), hits.size)) if hits.size else (math.nan,) * 3


def group(items: Iterable[Item], key: Callable[[Item], Key]) -> dict[Key, list[Item]]:
    """Results, or lines, by what they have in common, in the order in which each comes first."""
    found: dict[Key, list[Item]] = {}
    for item in items:
        found.setdefault(key(item), []).append(item)
    return found


@cache
def drawn_questions() -> frozenset[str]:
    """The keys of the scenarios that experiments draw: hundreds with one data set each, which speak together only."""
    return frozenset().union(*(questions(name) for name in choices("experiment") if drawn_scenarios(name)))


def questions(experiment: str) -> frozenset[str]:
    """The keys of the scenarios of an experiment, whatever the method."""
    cells = (Cell(scenario, "oracle", {}, 1, seed, "oracle") for scenario, seed in Experiment(experiment).scenarios())
    return frozenset(Result.of_cell(cell, None).question for cell in cells)


def table_experiments() -> list[str]:
    """The experiments that describe a table."""
    return [name for name in choices("experiment") if Experiment(name).table]


def experiment_frame(experiment: str, store: Store) -> Frame:
    """The cells of an experiment, with what the store holds of each."""
    found = Experiment(experiment)
    results = [Result.of_cell(cell, store.load(cell.identity)) for cell in found.cells()]
    if found.table.get("form") == "family":
        results += supplied_results(store, {result.question for result in results})
    return Frame(experiment, str(found.table["title"]), found.table, tuple(results))


def supplied_results(store: Store, questions: Collection[str]) -> list[Result]:
    """Return stored cells of a method whose settings name what another package supplies, on some questions."""

    def supplied(head: CellHead) -> bool:
        method, card = head.cell.get("method"), cards().get(str(head.cell.get("method")))
        if card is None or not card.choices:
            return False
        return bool(settings_version(str(method), head.cell["data"]["system"], head.cell["settings"]).supplied)

    return [result for result in _of_today(store, supplied) if result.question in questions]


def submitted_results(store: Store) -> list[Result]:
    """Return the cells of a store that were submitted; without ``cell`` where their method is not installed here."""
    return _of_today(store, lambda head: head.label.endswith(MARK))


def _of_today(store: Store, wanted: Callable[[CellHead], bool]) -> list[Result]:
    """Return stored cells as cells of the present code describe them, or as they are where it has no method for one."""
    results = []
    for head in store.heads():
        with contextlib.suppress(InputError):  # what its settings name is not installed here
            if not head.problem and wanted(head) and (stored := store.load(head.identity)):
                results.append(Result.of_stored(stored))
                results[-1] = Result.of_cell(stored_as_cell(stored), stored)
    return results


SHOWING_SUBMITTED = ("paper", "systems", "open")
"""Forms of tables whose rows are methods, any of which may be another's."""


def with_submitted(frame: Frame, submitted: Sequence[Result]) -> Frame:
    """The frame of an experiment with the submitted methods that have every scenario of it behind its own."""
    if frame.form not in SHOWING_SUBMITTED:
        return frame
    asked = {result.question for result in frame if not result.is_reference}
    found: list[Result] = []
    for own in group(submitted, lambda result: result.label).values():
        shown = (result for result in own if result.cell or frame.table.get("form") == "open")
        mine = {result.question: result for result in shown if result.question in asked}
        if mine.keys() == asked:
            found += mine.values()
    return replace(frame, results=(*frame.results, *found))


def stored_results(store: Store) -> list[Result]:
    """All cells of a store; raises InputError where there is none, or for a file that is no cell."""
    if not store.there():
        raise InputError("store", store.folder, "there is no such folder; run some cells first")
    found = [Result.of_stored(stored) for stored in store]
    if not found:
        raise InputError(
            "store", store.folder, "no cell is stored there; run python -m bench -m experiment=table3 first"
        )
    return found
