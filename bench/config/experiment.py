"""Experiments, and the jobs and cells of a sweep: every combination of values, validated before any runs."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from bench.config.choices import GROUPS, check_choice, choices, default_choices
from bench.config.composition import Part, composed, part_of
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
        if not isinstance(self.name, str):
            raise InputError("experiment", self.name, f"the name of one: {', '.join(choices('experiment'))}")
        check_choice("experiment", self.name)

    @cached_property
    def content(self) -> Mapping[str, Any]:
        """Return its file over the experiments that it starts from."""
        part = Part("experiment", self.name)
        return composed([part])[part]

    @property
    def table(self) -> Mapping[str, Any]:
        """What is said of its table: ``title``, ``number``, ``form``, ``release``; empty where it describes none."""
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
        """Its jobs; what is overridden is no longer the part of it that a further sweep describes."""
        own = overrides or {}
        if "experiment" in own:
            raise InputError("experiment", own["experiment"][0], "given twice; give it once")
        blocks = self._overridden(own)
        return [job for block in blocks for job in _product(block, self.content, frozenset(own))]

    def _overridden(self, own: Overrides) -> list[dict[str, list[Any]]]:
        """The sweeps where some fields are overridden; of drawn scenarios those that are named, if any are."""
        if self.content.get("draw"):
            rest = {field: values for field, values in own.items() if field != "system"}
            return [{**b, **rest} for b in self.blocks if b["system"][0] in own.get("system", b["system"])]
        further = self.content.get("also", [])
        kept = [b for b, extra in zip(self.blocks, [{}, *further], strict=True) if not set(extra) & set(own)]
        return [{**block, **own} for block in kept]

    def cells(self, overrides: Overrides | None = None) -> list[Cell]:
        """Its cells in order; one that stands in several of its sweeps stands here as often."""
        return [job.cell() for job in self.jobs(overrides)]

    def scenarios(self) -> Iterator[tuple[Scenario, int]]:
        """Its scenarios with their seeds, method apart: all methods of a sweep have the same."""
        for block in self.blocks:
            for job in _product({**block, "method": block.get("method", ["oracle"])[:1]}, self.content):
                yield job.scenario, job.config.seed


def sweep(overrides: Overrides, multirun: bool = True, measured: bool = False) -> list[Job]:
    """The jobs of some overrides, over those of the experiments among them.

    ``measured``: they are of a record, though none is named, as where it is given as arrays. Raises InputError for what
    makes no sense, and for several values without ``multirun``.
    """
    if not multirun:
        _check_single(overrides)
    own = {field: values for field, values in overrides.items() if field != "experiment"}
    if not measured and all(value is None for value in own.get("data", [])):
        check_of_records(own)
    found: list[Job] = []
    for name in overrides.get("experiment", [None]):
        found += _product(own, {}, frozenset(own)) if name is None else Experiment(name).jobs(own)
    return found


def expand(texts: Sequence[str], multirun: bool) -> list[Job]:
    """The jobs of a command line; raises InputError."""
    return sweep(read_overrides(texts), multirun)


def _check_single(overrides: Overrides) -> None:
    names = [name for name in overrides.get("experiment", []) if name is not None]
    swept = {**(Experiment(names[0]).blocks[0] if names else {}), **overrides}
    for field, values in swept.items():
        if len(values) > 1:
            raise InputError(field, written(values), "several values need -m: python -m bench -m ...")


def _product(sweep: Overrides, experiment: Mapping[str, Any], explicit: frozenset[str] = frozenset()) -> list[Job]:
    for field, values in sweep.items():
        if len(values) > 1 and field.partition(".")[0] not in SWEPT:
            raise InputError(field, written(values), "one value: it is of the run, not of a cell")
    for group in set(GROUPS) & set(sweep):
        for value in sweep[group]:
            check_choice(group, value)
    if "method" not in sweep:
        raise InputError("method", "", f"choose one: {', '.join(choices('method'))}")
    number = math.prod(map(len, sweep.values()))
    if number > MOST_CELLS:
        widest = max(sweep, key=lambda field: len(sweep[field]))
        remedy = f"{number} cells in all, at most {MOST_CELLS}; sweep over less at a time"
        raise InputError(widest, f"{len(sweep[widest])} values", remedy)
    every = [dict(zip(sweep, values, strict=True)) for values in itertools.product(*sweep.values())]
    parts = [{group: _part(group, chosen) for group in COMPOSED} for chosen in every]
    contents = composed([part for own in parts for part in own.values()])
    return [
        _job(chosen, {group: contents[part] for group, part in own.items()}, experiment, explicit)
        for chosen, own in zip(every, parts, strict=True)
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
