"""Experiments, and the jobs and cells of a sweep: every combination of values, validated before any runs."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from bench.config.choices import GROUPS, check_choice, choices, default_choices
from bench.config.composition import Part, composed, content_of, part_of
from bench.config.declaration import written
from bench.config.drawn import drawn_scenarios
from bench.config.fields import GROUPS as COMPOSED
from bench.config.fields import SWEPT
from bench.config.overrides import DELETED, Overrides, check_of_records, read_overrides
from bench.config.schema import Job, config_from
from bench.errors import InputError
from bench.scenario.scenario import Scenario
from bench.store.cell import Cell

MOST_CELLS = 200_000
"""Most cells of one sweep."""
OF_EXPERIMENTS = ("draw", "sweep", "also", "replicates_by_method", "table", "defaults")
"""Fields that only an experiment sets."""


@dataclass(frozen=True)
class Experiment:
    """A file of ``conf/experiment``: sweeps with their replicates, and the table that is made of them.

    Raises InputError for an unknown name. ``Experiment("table3").cells({"method": ["ls"]})`` are those of one method.
    """

    name: str

    def __post_init__(self) -> None:
        check_choice("experiment", str(self.name))

    @cached_property
    def content(self) -> Mapping[str, Any]:
        """Its file over the experiments that it starts from."""
        return content_of("experiment", self.name)

    @property
    def table(self) -> Mapping[str, Any]:
        """The description of its table: ``title``, ``number``, ``form``, ``release``; empty where there is none."""
        release = {"release": drawn["release"]} if (drawn := self.content.get("draw")) else {}
        return {**table, **release} if (table := self.content.get("table")) else {}

    @property
    def blocks(self) -> list[dict[str, list[Any]]]:
        """Its sweeps: the first, and each further one with what it has in common with the first.

        Where it draws scenarios, one for each of them.
        """
        first = self.content.get("sweep", {})
        if self.content.get("draw"):
            return [{**drawn.block(), **first} for drawn in drawn_scenarios(self.name)]
        return [dict(first), *({**first, **block} for block in self.content.get("also", []))]

    def jobs(self, overrides: Overrides | None = None) -> list[Job]:
        """Return its jobs; a further sweep that sets an overridden field is left out."""
        given = overrides or {}
        if "experiment" in given:
            raise InputError("experiment", given["experiment"][0], "given twice; give it once")
        if self.content.get("draw"):  # of the drawn scenarios those that are named, if any are
            rest = {field: values for field, values in given.items() if field != "system"}
            blocks = [{**b, **rest} for b in self.blocks if b["system"][0] in given.get("system", b["system"])]
        else:
            further = [{}, *self.content.get("also", [])]
            kept = [b for b, extra in zip(self.blocks, further, strict=True) if not extra.keys() & given.keys()]
            blocks = [{**block, **given} for block in kept]
        return [job for block in blocks for job in _product(block, self.content, frozenset(given))]

    def cells(self, overrides: Overrides | None = None) -> list[Cell]:
        """Return its cells in order; one that stands in several of its sweeps stands here as often."""
        return [job.cell() for job in self.jobs(overrides)]

    def scenarios(self) -> Iterator[tuple[Scenario, int]]:
        """Give its scenarios with their seeds, method apart: all methods of a sweep have the same."""
        for block in self.blocks:
            for job in _product({**block, "method": block.get("method", ["oracle"])[:1]}, self.content):
                yield job.scenario, job.config.seed


def sweep(overrides: Overrides, multirun: bool = True, measured: bool = False) -> list[Job]:
    """Return the jobs of overrides, over those of the experiments among them.

    Args:
        overrides: fields with their values.
        multirun: whether a field may have several.
        measured: the jobs are of a record though no file is named, as where it is given as arrays.

    Raises:
        InputError: for what makes no sense.
    """
    experiments = [name for name in overrides.get("experiment", []) if name is not None]
    if not multirun:
        swept = {**(Experiment(experiments[0]).blocks[0] if experiments else {}), **overrides}
        for field, values in swept.items():
            if len(values) > 1:
                raise InputError(field, written(values), "several values need -m: python -m bench -m ...")
    given = {field: values for field, values in overrides.items() if field != "experiment"}
    if not measured and all(value is None for value in given.get("data", [])):
        check_of_records(given)
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
            raise InputError(field, written(values), "one value: it is of the run, not of a cell")
    if "method" not in sweep:
        raise InputError("method", "", f"choose one: {', '.join(choices('method'))}")
    number = math.prod(map(len, sweep.values()))
    if number > MOST_CELLS:
        widest = max(sweep, key=lambda field: len(sweep[field]))
        remedy = f"{number} cells in all, at most {MOST_CELLS}; sweep over less at a time"
        raise InputError(widest, f"{len(sweep[widest])} values", remedy)
    combinations = [dict(zip(sweep, values, strict=True)) for values in itertools.product(*sweep.values())]
    parts = [{group: _part(group, chosen) for group in COMPOSED} for chosen in combinations]
    contents = composed([part for by_group in parts for part in by_group.values()])
    return [
        _job(chosen, {group: contents[part] for group, part in by_group.items()}, experiment, explicit)
        for chosen, by_group in zip(combinations, parts, strict=True)
    ]


def _part(group: str, chosen: Mapping[str, Any]) -> Part:
    below = {k.removeprefix(f"{group}."): value for k, value in chosen.items() if k.startswith(f"{group}.")}
    return part_of(group, chosen.get(group, default_choices()[group]), below)


def _job(
    chosen: Mapping[str, Any],
    groups: dict[str, Any],
    experiment: Mapping[str, Any],
    explicit: frozenset[str],
) -> Job:
    """Return the job of one combination: the fields of its experiment, over them those that are chosen."""
    if "prior" not in chosen and "default_prior" in groups["system"]:
        check_choice("prior", groups["system"]["default_prior"])
        prior = _part("prior", {**chosen, "prior": groups["system"]["default_prior"]})
        groups["prior"] = composed([prior])[prior]
    values = {k: v for k, v in experiment.items() if k not in OF_EXPERIMENTS} | groups
    by_method = experiment.get("replicates_by_method", {})
    if chosen["method"] in by_method and "replicates" not in explicit:
        values["replicates"] = by_method[chosen["method"]]
    for field, value in chosen.items():
        name, _, below = field.partition(".")
        if name not in GROUPS:
            values[name] = {**values.get(name, {}), below: value} if below else value
    settings = [f"{k.partition('.')[2]}={v}" for k, v in chosen.items() if k.startswith("method.") and v is not DELETED]
    return Job(config_from(values), " ".join([str(chosen["method"]), *settings]), explicit)
