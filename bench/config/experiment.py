"""Experiments and sweeps: every combination of values becomes a validated job before any runs."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from bench.config.choices import GROUPS, check_choice, choices, default_choices
from bench.config.composition import content_of
from bench.config.declaration import written
from bench.config.fields import GROUPS as COMPOSED
from bench.config.fields import SWEPT
from bench.config.overrides import DELETED, Overrides, check_record_fields, read_overrides
from bench.config.random_scenarios import drawn_scenarios
from bench.config.schema import Job, config_from
from bench.errors import InputError
from bench.scenario.scenario import Scenario
from bench.store.cell import Cell

MOST_CELLS = 200_000
"""Largest number of cells of a sweep."""
EXPERIMENT_FIELDS = ("draw", "sweep", "also", "replicates_by_method", "table", "defaults")
"""Fields that only an experiment's file has."""


@dataclass(frozen=True)
class Experiment:
    """An experiment of ``conf/experiment``: its sweeps, and the table made of their results.

    ``Experiment("table3").cells({"method": ["ls"]})`` returns the cells of one method.

    Raises:
        InputError: The name is unknown.
    """

    name: str

    def __post_init__(self) -> None:
        check_choice("experiment", str(self.name))

    @cached_property
    def content(self) -> Mapping[str, Any]:
        """Content of its file, composed with the experiments of its ``defaults``."""
        return content_of("experiment", self.name)

    @property
    def table(self) -> Mapping[str, Any]:
        """Description of its table: ``title``, ``number``, ``form``, ``release``; empty if it has no table."""
        release = {"release": drawn["release"]} if (drawn := self.content.get("draw")) else {}
        return {**table, **release} if (table := self.content.get("table")) else {}

    @property
    def blocks(self) -> list[dict[str, list[Any]]]:
        """Its sweeps: ``sweep``, then each of ``also`` over the values of ``sweep``; or one per drawn scenario."""
        first = self.content.get("sweep", {})
        if self.content.get("draw"):
            return [{**drawn.block(), **first} for drawn in drawn_scenarios(self.name)]
        return [dict(first), *({**first, **block} for block in self.content.get("also", []))]

    def jobs(self, overrides: Overrides | None = None) -> list[Job]:
        """Return its jobs. A sweep of ``also`` that sets an overridden field is left out."""
        given = overrides or {}
        if "experiment" in given:
            raise InputError("experiment", given["experiment"][0], "given twice; give it once")
        if self.content.get("draw"):  # system= selects among the drawn scenarios
            rest = {field: values for field, values in given.items() if field != "system"}
            blocks = [{**b, **rest} for b in self.blocks if b["system"][0] in given.get("system", b["system"])]
        else:
            further = [{}, *self.content.get("also", [])]
            kept = [b for b, extra in zip(self.blocks, further, strict=True) if not extra.keys() & given.keys()]
            blocks = [{**block, **given} for block in kept]
        return [job for block in blocks for job in _product(block, self.content, frozenset(given))]

    def cells(self, overrides: Overrides | None = None) -> list[Cell]:
        """Return its cells in order; a cell that belongs to several sweeps is repeated."""
        return [job.cell() for job in self.jobs(overrides)]

    def scenarios(self) -> Iterator[tuple[Scenario, int]]:
        """Yield its scenarios with their seeds; they are the same for all methods of a sweep."""
        for block in self.blocks:
            for job in _product({**block, "method": block.get("method", ["oracle"])[:1]}, self.content):
                yield job.scenario, job.config.seed


def sweep(overrides: Overrides, multirun: bool = True, measured: bool = False) -> list[Job]:
    """Return the jobs of all combinations of overrides, applied to the experiments that they name.

    Args:
        overrides: Values by field.
        multirun: True if a field may have several values.
        measured: True if the jobs use a measured record that is given as arrays rather than as a file.

    Raises:
        InputError: A field has several values without ``multirun``, or the values are inconsistent.
    """
    experiments = [name for name in overrides.get("experiment", []) if name is not None]
    if not multirun:
        swept = {**(Experiment(experiments[0]).blocks[0] if experiments else {}), **overrides}
        for field, values in swept.items():
            if len(values) > 1:
                raise InputError(field, written(values), "several values need -m: python -m bench -m ...")
    given = {field: values for field, values in overrides.items() if field != "experiment"}
    if not measured and all(value is None for value in given.get("data", [])):
        check_record_fields(given)
    if not experiments:
        return _product(given, {}, frozenset(given))
    return [job for name in experiments for job in Experiment(name).jobs(given)]


def expand(texts: Sequence[str], multirun: bool) -> list[Job]:
    """Return the jobs of a command line; raises InputError."""
    return sweep(read_overrides(texts), multirun)


def _product(sweep: Overrides, experiment: Mapping[str, Any], explicit: frozenset[str] = frozenset()) -> list[Job]:
    """Return a job for every combination of values; raises InputError."""
    for field, values in sweep.items():
        if len(values) > 1 and field.partition(".")[0] not in SWEPT:
            raise InputError(field, written(values), "give one value; this field cannot be swept")
    if "method" not in sweep:
        raise InputError("method", "", f"choose one: {', '.join(choices('method'))}")
    number = math.prod(map(len, sweep.values()))
    if number > MOST_CELLS:
        widest = max(sweep, key=lambda field: len(sweep[field]))
        remedy = f"{number} cells in all, at most {MOST_CELLS}; sweep over less at a time"
        raise InputError(widest, f"{len(sweep[widest])} values", remedy)
    combinations = [dict(zip(sweep, values, strict=True)) for values in itertools.product(*sweep.values())]
    return [_job(chosen, experiment, explicit) for chosen in combinations]


def _group(group: str, chosen: Mapping[str, Any]) -> dict[str, Any]:
    below = {k.removeprefix(f"{group}."): value for k, value in chosen.items() if k.startswith(f"{group}.")}
    return content_of(group, chosen.get(group, default_choices()[group]), below)


def _job(chosen: Mapping[str, Any], experiment: Mapping[str, Any], explicit: frozenset[str]) -> Job:
    """Return the job of one combination of values, which take precedence over the fields of its experiment."""
    groups = {group: _group(group, chosen) for group in COMPOSED}
    if "prior" not in chosen and "default_prior" in groups["system"]:
        check_choice("prior", groups["system"]["default_prior"])
        groups["prior"] = _group("prior", {**chosen, "prior": groups["system"]["default_prior"]})
    values = {k: v for k, v in experiment.items() if k not in EXPERIMENT_FIELDS} | groups
    by_method = experiment.get("replicates_by_method", {})
    if chosen["method"] in by_method and "replicates" not in explicit:
        values["replicates"] = by_method[chosen["method"]]
    for field, value in chosen.items():
        name, _, below = field.partition(".")
        if name not in GROUPS:
            values[name] = {**values.get(name, {}), below: value} if below else value
    settings = [f"{k.partition('.')[2]}={v}" for k, v in chosen.items() if k.startswith("method.") and v is not DELETED]
    return Job(config_from(values), " ".join([str(chosen["method"]), *settings]), explicit)
