"""A composed configuration, validated: the fields of a run, and the scenario by its own declaration."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from typing import Any

from bench.config.fields import Config, flags
from bench.config.limits import check_numbers
from bench.entrants.reference import REFERENCES
from bench.entrants.registry import default_settings, make_method
from bench.errors import InputError
from bench.scenario import scenario as declared
from bench.scenario.declaration import validated
from bench.scenario.disturbance import Disturbance
from bench.scenario.scenario import KEY, PriorSpec, Scenario, config_path
from bench.store.cell import Cell

SCENARIO = ("system", "prior", "disturbance")
"""Groups that hold the numbers of a scenario."""
WRITTEN = {"from_": "from"}
"""Fields of a run that are written otherwise than their attribute."""


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
        names = {config_path(f).partition(".")[0] for f in fields(declared.Scenario)}
        stated = {name: getattr(self.config, name) for name in sorted(names)}
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
    """Return the validated fields of a run; raises InputError."""
    for name, value in content.items():
        if isinstance(value, bool) and name not in flags():
            raise InputError(name, value, "a number or a name, not true or false")
        if name in flags() and not isinstance(value, bool):
            raise InputError(name, value, "true or false")
    return validated(Config, {"from_" if name == "from" else name: value for name, value in content.items()}, WRITTEN)


@lru_cache(maxsize=1024)
def _shared_scenario(stated: str) -> Scenario:
    """The scenario of what is stated as JSON: one for the cells of all methods, which share what it works out."""
    return scenario_from(json.loads(stated))


def scenario_from(content: Mapping[str, Any]) -> Scenario:
    """The scenario of a composed configuration: each field from where its declaration says; raises InputError."""
    check_numbers({name: content[name] for name in SCENARIO})
    kind = declared.Scenario
    paths = {f.name: config_path(f) for f in fields(kind)}
    system = {name: value for name, value in content["system"].items() if name != "default_prior"}
    given = {**content, "prior": _prior(content["prior"]), "disturbance": _disturbance(content["disturbance"])}
    values = {}
    for f in fields(kind):
        group, _, name = paths[f.name].partition(".")
        if not name:
            values[f.name] = given[group]
        elif name in system:
            values[f.name] = system.pop(name)
        elif f.name in ("label", *KEY):
            raise InputError(paths[f.name], "", "field required")
    return validated(kind, values, paths)


def _prior(content: Mapping[str, Any]) -> PriorSpec | None:
    if content["sd_by_kind"] is None:
        return None
    return validated(PriorSpec, content, {f.name: f"prior.{f.name}" for f in fields(PriorSpec)})


def _disturbance(content: Mapping[str, Any]) -> Disturbance | None:
    settings = {name: value for name, value in content.items() if name != "kind" and value is not None}
    if content["kind"] == "none" and not settings:
        return None
    return Disturbance.from_dict({"kind": content["kind"], **settings})
