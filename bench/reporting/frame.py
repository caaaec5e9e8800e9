"""The read model of all tables, figures and pages: stored cells, and the cells that an experiment describes.

A :class:`Result` is one cell, run or not, with its scenario and its scores; no other module reads the keys of a stored
description. A :class:`Frame` is the results of one experiment; the results of a store are a plain list.
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
from bench.store.stored_cell import MARK, SUBMITTED, CellHead, StoredCell
from bench.store.version import described_version
from bench.systems import System, make_system

ERROR = "_error_pct"
Line = Mapping[str, Any]
"""Values of a line of a tidy table, by column."""
Item = TypeVar("Item")
Key = TypeVar("Key", bound=Hashable)


@dataclass(frozen=True, eq=False)
class Result:
    """One cell: its scenario, and its stored scores (None if it was not run).

    Arrays by replicate have the shape (n,).

    Attributes:
        system: Name of the system in tables.
        kind: Name of the registered system.
        prior: Widths of the prior, by kind of parameter.
        data: Part of the description that determines the data of a replicate.
        parameters: True values (SI units).
        disturbance: Kind of disturbance; empty for none.
        duration: Length of the record (s).
        samples: Samples per sensor; 0 if unknown.
        n_dof: Number of moving masses; 0 if unknown.
        added_mass: Known masses (kg, one per DOF) added in a second record; empty for a single record.
        truth_drawn: Whether each replicate has its own true values.
        stored: The stored cell, or None.
        cell: The cell as an experiment describes it, or None for a cell that is only stored.
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
        """Read a stored description, which may lack any field if another program wrote it."""
        data, given, method = what.get("data", {}), what.get("told", {}), str(what.get("method", "?"))
        disturbance, kind = data.get("disturbance") or {}, str(data.get("system", "?"))
        snr = what.get("snr_db", data.get("snr_db"))
        return cls(
            label=str(what.get("label") or method),
            method=method,
            system=str(what.get("system") or kind),
            kind=kind,
            snr_db=math.nan if snr is None else float(snr),
            initial_state=str(what.get("initial_state") or given.get("initial_state", "?")),
            seed=int(what.get("seed") or 0),
            prior=given.get("prior"),
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
        """Make the result of a cell of an experiment and of its stored cell, if there is one."""
        scenario = cell.scenario
        what = {"label": cell.label, "system": scenario.label, "snr_db": scenario.snr_db}
        return cls.of_description({**cell.description(), **what}, stored, cell)

    @classmethod
    def of_stored(cls, stored: StoredCell) -> Result:
        """Make the result of a stored cell."""
        return cls.of_description(stored.cell, stored)

    # ---- facts of the scenario

    @property
    def force(self) -> str:
        """The shape of the known force, with its amplitude if that is stored; empty in free vibration."""
        force = self.data.get("force") or {}
        # a stored description names every shape but the default
        shape = str(force.get("kind", "multisine")).replace("_", " ") if force else ""
        return shape + (f", amplitude {float(force['amplitude']):g} N" if "amplitude" in force else "")

    @property
    def known_initial_state(self) -> InitialState | None:
        """The initial state, if it was given to the methods."""
        if self.initial_state != "known" or "initial" not in self.data:
            return None
        displacement, velocity = self.data["initial"]
        return InitialState(np.array(displacement, float), np.array(velocity, float))

    @cached_property
    def question(self) -> str:
        """Key of cells that differ in the method alone: the same data, known quantities and seed."""
        given = {"initial_state": self.initial_state, "prior": self.prior}
        return json.dumps([self.data, given, self.seed, self.system], sort_keys=True, default=str)

    @cached_property
    def series(self) -> str:
        """Key of cells that differ in method, noise level and known initial state alone."""
        data = {key: value for key, value in self.data.items() if key != "snr_db"}
        return json.dumps({"data": data, "prior": self.prior, "seed": self.seed}, sort_keys=True)

    @cached_property
    def model(self) -> System:
        """The system whose equations the methods were given; raises InputError if it is not registered."""
        return make_system(self.kind, self.data.get("options", {}))

    @property
    def known_model(self) -> System | None:
        """The system whose equations the methods were given; None if it is not registered."""
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
        """Identity of the cell in a store."""
        return self.stored.identity if self.stored else self.cell.identity if self.cell else ""

    @property
    def is_reference(self) -> bool:
        """Whether the method is a reference row, which uses the true values or no data and is not ranked."""
        return self.method in REFERENCES

    @property
    def title(self) -> str:
        """Title of the method."""
        return title(self.label)

    # ---- scores

    @property
    def n(self) -> int:
        """Number of stored replicates."""
        return len(self.stored.columns) if self.stored else 0

    @cached_property
    def statuses(self) -> tuple[Status, ...]:
        return self.stored.columns.statuses if self.stored else ()

    @cached_property
    def ok(self) -> np.ndarray:
        """Whether each replicate succeeded, booleans (n,)."""
        return np.array([status is Status.OK for status in self.statuses], bool)

    @cached_property
    def n_ok(self) -> int:
        return int(self.ok.sum())

    @property
    def state(self) -> str:
        """``current``, ``stale`` if another version computed it, ``missing``, or empty for an unknown experiment."""
        if self.cell is None or self.stored is None:
            return "missing" if self.stored is None else ""
        return "current" if self.cell.version.matches(self.stored.version) else "stale"

    @property
    def status(self) -> Status:
        """``ok`` if any replicate succeeded, else the most frequent failure."""
        assert self.stored is not None
        return self.stored.status

    @property
    def verification(self) -> str:
        """A sentence on the verification of a submitted cell; empty if the cell was not submitted."""
        facts = self.stored.provenance.get(SUBMITTED) if self.stored else None
        if facts is None:
            return ""
        compared, rows, missed = (facts.get(name) for name in ("rows_compared", "of_rows", "missed_5_percent"))
        if not (isinstance(compared, int) and isinstance(rows, int)):  # a store is data, and may state anything
            return "submitted; its verification is not recorded"
        sentence = f"submitted; {compared} of its {rows} rows were recomputed when it was merged, with the same result"
        if not isinstance(missed, float):
            return sentence
        return f"{sentence} (a change of 5 % of the rows is missed with probability {missed:.2g})"

    @property
    def summary(self) -> Mapping[str, Mapping[str, float]]:
        """Stored statistics over the replicates, by metric."""
        return self.stored.summary if self.stored else {}

    @property
    def identifiable(self) -> Mapping[str, bool]:
        """Whether each quantity is identifiable from the data alone."""
        return self.stored.identifiable if self.stored else {}

    @property
    def prior_share(self) -> Mapping[str, float]:
        """Share of the bound's variance that is due to the prior, by quantity."""
        return self.stored.prior_share if self.stored else {}

    def statistic(self, metric: str, name: str) -> float:
        """Return ``mean``, ``median``, ``ci_low``, ``ci_high``, ``bound`` or ``excess`` of a metric, or NaN."""
        return float(self.summary.get(metric, {}).get(name, math.nan))

    def bound(self, metric: str) -> float:
        """Return the Cramér-Rao bound on the root mean square of a metric."""
        return self.statistic(metric, "bound")

    def excess(self, metric: str) -> float:
        """Return the root mean square error of the successful replicates over the bound."""
        return self.statistic(metric, "excess")

    def coverage(self, quantity: str, level: int = 95) -> tuple[float, float, float]:
        """Return the coverage: the share of the successful fits' intervals that contain the true value.

        Returns:
            Coverage, and the ends of its 95 % interval; NaNs without any interval.
        """
        return share(self.successful(f"{quantity}_coverage_{level}"))

    def scores(self, name: str) -> np.ndarray:
        """Return a score by replicate (n,), NaN where a replicate has none."""
        if name not in self._columns:
            self._columns[name] = self.stored.columns.scores(name) if self.stored else np.empty(0)
        return self._columns[name]

    def errors(self, metric: str) -> np.ndarray:
        """Return the errors of a metric by replicate (n,), infinite where a replicate failed."""
        values = self.scores(metric)
        return np.where(np.isnan(values), math.inf, values)

    def successful(self, name: str, n: int | None = None) -> np.ndarray:
        """Return the finite scores of the successful replicates, all or among the first ``n``."""
        values = self.scores(name)[:n]
        return np.asarray(values[self.ok[:n] & np.isfinite(values)])

    def first(self, name: str) -> float:
        """Return the score of replicate 0, whose arrays are stored."""
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
        """Return the arrays of replicate 0 in double precision; none if they are missing or damaged."""
        if self.stored:
            with contextlib.suppress(InputError):
                arrays = self.stored.arrays.items()
                return {name: a.astype(float) if a.dtype.kind == "f" else a for name, a in arrays}
        return {}


@dataclass(frozen=True, eq=False)
class Frame:
    """The results of an experiment with a table, in the experiment's order."""

    experiment: str
    title: str
    table: Mapping[str, Any]
    results: tuple[Result, ...]

    def __iter__(self) -> Iterator[Result]:
        return iter(self.results)

    @property
    def number(self) -> int | None:
        """Number of the table, or None."""
        return int(self.table["number"]) if self.table.get("number") else None

    @property
    def name(self) -> str:
        """Name of the table's files, without ending."""
        return f"table{self.number}" if self.number else self.experiment

    @property
    def form(self) -> str:
        """Form of the table."""
        return str(self.table.get("form", "paper"))

    @property
    def command(self) -> str:
        """Command that recomputes the experiment and its table."""
        return f"python -m bench -m experiment={self.experiment} && python -m bench tables"

    @property
    def footer(self) -> str:
        """Last line of the page: when the fits were computed, and the command that regenerates the table."""
        return f"{computed(self)}Regenerate: `{self.command}`"


def computed(results: Iterable[Result]) -> str:
    """Return a sentence with the first and the last day (UTC) of computation; empty without dates."""
    starts = [str(result.stored.provenance.get("started") or "")[:10] for result in results if result.stored]
    days = sorted({start for start in starts if start})
    return f"Computed {' to '.join(dict.fromkeys((days[0], days[-1])))}. " if days else ""


def quantity(metric: str) -> str:
    """Return the quantity of an error metric."""
    return metric.removesuffix(ERROR)


def share(hits: np.ndarray) -> tuple[float, float, float]:
    """Return the share of ones among zeros and ones (n,), with its 95 % interval (Wilson); NaNs if there are none."""
    return (float(hits.mean()), *wilson_interval(int(hits.sum()), hits.size)) if hits.size else (math.nan,) * 3


def group(items: Iterable[Item], key: Callable[[Item], Key]) -> dict[Key, list[Item]]:
    """Group items by key, in the order in which the keys first occur."""
    groups: dict[Key, list[Item]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return groups


@cache
def drawn_questions() -> frozenset[str]:
    """Return the keys of the scenarios that experiments draw at random: hundreds, each with one data set."""
    return frozenset().union(*(questions(name) for name in choices("experiment") if drawn_scenarios(name)))


def questions(experiment: str) -> frozenset[str]:
    """Return the keys of the scenarios of an experiment."""
    cells = (Cell(scenario, "oracle", {}, 1, seed, "oracle") for scenario, seed in Experiment(experiment).scenarios())
    return frozenset(Result.of_cell(cell, None).question for cell in cells)


def table_experiments() -> list[str]:
    """Return the experiments that have a table."""
    return [name for name in choices("experiment") if Experiment(name).table]


def experiment_frame(name: str, store: Store) -> Frame:
    """Return the cells of an experiment, with their stored cells."""
    experiment = Experiment(name)
    results = [Result.of_cell(cell, store.load(cell.identity)) for cell in experiment.cells()]
    if experiment.table.get("form") == "family":
        results += supplied_results(store, {result.question for result in results})
    return Frame(name, str(experiment.table["title"]), experiment.table, tuple(results))


def supplied_results(store: Store, questions: Collection[str]) -> list[Result]:
    """Return stored cells, on some questions, of methods with a setting that another package supplies."""

    def supplied(head: CellHead) -> bool:
        card = cards().get(str(head.cell.get("method")))
        if card is None or not card.choices:
            return False
        return bool(described_version(head.cell).supplied)

    return [result for result in _current_results(store, supplied) if result.question in questions]


def submitted_results(store: Store) -> list[Result]:
    """Return the submitted cells of a store; ``cell`` is None if the method is not installed."""
    return _current_results(store, lambda head: head.label.endswith(MARK))


def _current_results(store: Store, wanted: Callable[[CellHead], bool]) -> list[Result]:
    """Return stored cells as the present code describes them, or as stored if their method is not installed."""
    results = []
    for head in store.heads():
        with contextlib.suppress(InputError):  # a package that the settings name is not installed
            if not head.problem and wanted(head) and (stored := store.load(head.identity)):
                results.append(Result.of_stored(stored))
                results[-1] = Result.of_cell(stored_as_cell(stored), stored)
    return results


SHOWING_SUBMITTED = ("paper", "systems", "open")
"""Forms of tables with a row per method, which show submitted methods too."""


def with_submitted(frame: Frame, submitted: Sequence[Result]) -> Frame:
    """Append to a frame the submitted methods that have a result for each of its scenarios."""
    if frame.form not in SHOWING_SUBMITTED:
        return frame
    questions = {result.question for result in frame if not result.is_reference}
    complete: list[Result] = []
    for members in group(submitted, lambda result: result.label).values():
        shown = (result for result in members if result.cell or frame.table.get("form") == "open")
        by_question = {result.question: result for result in shown if result.question in questions}
        if by_question.keys() == questions:
            complete += by_question.values()
    return replace(frame, results=(*frame.results, *complete))


def stored_results(store: Store) -> list[Result]:
    """Return all cells of a store; raises InputError for an empty store, or a file that is no cell."""
    if not store.exists():
        raise InputError("store", store.folder, "there is no such folder; run some cells first")
    results = [Result.of_stored(stored) for stored in store]
    if not results:
        raise InputError(
            "store", store.folder, "no cell is stored there; run python -m bench -m experiment=table3 first"
        )
    return results
