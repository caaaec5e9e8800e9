"""A composed configuration, validated: the fields of a run, and the scenario by its own declaration."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from bench.config.limits import check_numbers, check_options
from bench.contract.problem import Hold
from bench.entrants.reference import REFERENCES
from bench.entrants.registry import default_settings, make_method
from bench.errors import InputError
from bench.scenario import scenario as declared
from bench.scenario.declaration import validated
from bench.scenario.disturbance import Disturbance, kind_of
from bench.scenario.scenario import PriorSpec, Scenario, config_path
from bench.store.cell import Cell

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(allow_inf_nan=False, gt=0)]
MOST_WORKERS = 1024
MOST_REPLICATES = 1_000_000
MOST_TIMEOUT_S, LEAST_MEMORY_MB, MOST_MEMORY_MB = 1e9, 100.0, 1e9
SCENARIO = ("system", "prior", "disturbance")
"""The groups that hold the numbers of a scenario."""
FLAGS = ("dry_run", "detrend")
"""The fields of a run that are true or false."""


class Config(BaseModel):
    """What a configuration says beside the scenario: the method, how often, from which seed, where, within what limits.

    The groups of the scenario stand here as they are written. Unknown fields are refused.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)
    method: dict[str, Any]
    system: dict[str, Any]
    prior: dict[str, Any]
    disturbance: dict[str, Any]
    snr: Any
    initial_state: Any
    replicates: Annotated[int, Field(ge=1, le=MOST_REPLICATES)]
    seed: Annotated[int, Field(ge=0, lt=2**63)]
    store: Path
    archive: str | None
    format: Literal["table", "json"]
    workers: Annotated[int, Field(ge=1, le=MOST_WORKERS)] | None
    timeout_s: Annotated[float, Field(allow_inf_nan=False, gt=0, le=MOST_TIMEOUT_S)]
    memory_mb: Annotated[float, Field(allow_inf_nan=False, ge=LEAST_MEMORY_MB, le=MOST_MEMORY_MB)]
    retry: str
    dry_run: bool
    cells_per_job: Annotated[int, Field(ge=1, le=1_000_000)]
    data: str | None
    columns: str | None
    units: str | None
    rate: Positive | None
    first: Annotated[Finite | None, Field(alias="from")]
    last: Annotated[Finite | None, Field(alias="to")]
    decimate: Annotated[int, Field(ge=1, le=10_000)]
    detrend: bool
    force_gain: Finite
    hold: Hold
    fixed: dict[str, Annotated[float, Field(allow_inf_nan=False, ge=0)]]
    nominal: dict[str, Positive]
    start: list[Finite] | None
    plot: Literal["auto", "always", "never"]
    picture: str | None


@dataclass(frozen=True)
class Job:
    """A validated configuration, with the variant of the method as it was named."""

    config: Config
    label: str
    explicit: frozenset[str]
    """Fields that the user set, as opposed to defaults."""

    @cached_property
    def scenario(self) -> Scenario:
        """The scenario; raises InputError where it does not make sense."""
        stated = self.config.model_dump(include={config_path(f).partition(".")[0] for f in fields(declared.Scenario)})
        return _shared_scenario(json.dumps(stated, default=str))

    def prior_spec(self) -> PriorSpec | None:
        """The prior, None for none."""
        return _prior(self.config.prior)

    def settings(self) -> dict[str, Any]:
        """All settings of the method, defaults included, as validated plain values."""
        name, given = self.config.method["name"], {k: v for k, v in self.config.method.items() if k != "name"}
        if name in REFERENCES:
            return {}
        for key, default in default_settings(name).items():
            if isinstance(given.get(key), bool) and not isinstance(default, bool):
                raise InputError(f"method.{key}", given[key], "not true or false")
        method = make_method(name, given)
        return {key: getattr(method, key) for key in default_settings(name)}

    def cell(self) -> Cell:
        """The cell; raises InputError where the scenario or a setting does not make sense."""
        return Cell(
            scenario=self.scenario,
            method=self.config.method["name"],
            settings={key: list(v) if isinstance(v, tuple) else v for key, v in self.settings().items()},
            replicates=self.config.replicates,
            seed=self.config.seed,
            label=self.label,
        )


def config_from(content: Mapping[str, Any]) -> Config:
    """The validated fields of a composed configuration; raises InputError."""
    if not str(content["store"] or ""):
        raise InputError("store", "", "name a folder")
    for name, value in content.items():
        if isinstance(value, bool) and name not in FLAGS:
            raise InputError(name, value, "a number or a name, not true or false")
        if name in FLAGS and not isinstance(value, bool):
            raise InputError(name, value, "true or false")
    return validated(Config, content)


@lru_cache(maxsize=1024)
def _shared_scenario(stated: str) -> Scenario:
    """The scenario of what is stated as JSON: one for the cells of all methods, which share what it works out."""
    return scenario_from(json.loads(stated))


def scenario_from(content: Mapping[str, Any]) -> Scenario:
    """The scenario of a composed configuration: each field from where its declaration says; raises InputError."""
    check_numbers({name: content[name] for name in SCENARIO})
    check_options(content["system"])
    kind = declared.Scenario
    system = {name: value for name, value in content["system"].items() if name != "default_prior"}
    given = {**content, "prior": _prior(content["prior"]), "disturbance": _disturbance(content["disturbance"])}
    paths = {f.name: config_path(f) for f in fields(kind)}
    values = {}
    for f in fields(kind):
        group, _, name = paths[f.name].partition(".")
        if not name:
            values[f.name] = given[group]
        elif name in system:
            values[f.name] = system.pop(name)
        elif f.name == "label" or (f.metadata.get("stated") and "part" not in f.metadata):
            raise InputError(paths[f.name], "", "field required")
    for name, value in system.items():
        raise InputError(f"system.{name}", value, "extra inputs are not permitted")
    return validated(kind, values, paths)


def _prior(content: Mapping[str, Any]) -> PriorSpec | None:
    if content["sd_by_kind"] is None:
        return None
    return validated(PriorSpec, content, {f.name: f"prior.{f.name}" for f in fields(PriorSpec)})


def _disturbance(content: Mapping[str, Any]) -> Disturbance | None:
    settings = {name: value for name, value in content.items() if name != "kind" and value is not None}
    if content["kind"] == "none" and not settings:
        return None
    return validated(kind_of(content["kind"], settings), settings, {name: f"disturbance.{name}" for name in settings})
