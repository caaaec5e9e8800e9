"""Validation of a composed configuration: the fields of a run, and the scenario by its own declaration."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from typing import Any, get_args

from bench.config.fields import Config, declared
from bench.config.limits import check_numbers, check_system
from bench.entrants.reference import REFERENCES
from bench.entrants.registry import default_settings, make_method
from bench.errors import InputError, did_you_mean
from bench.scenario import scenario as declaration
from bench.scenario.declaration import validated
from bench.scenario.disturbance import Disturbance
from bench.scenario.scenario import KEY, PriorSpec, Scenario, config_path
from bench.store.cell import Cell
from bench.systems.contract import Kind

SCENARIO = ("system", "prior", "disturbance", "snr", "initial_state")
"""Fields of a run that define the scenario; the first three are groups."""
KINDS = get_args(Kind)
WRITTEN = {"from_": "from"}
"""Names on the command line of the attributes that differ from them."""


@dataclass(frozen=True)
class Job:
    """A validated configuration; ``label`` names the method's variant, ``explicit`` the fields that the user set."""

    config: Config
    label: str
    explicit: frozenset[str]

    @cached_property
    def scenario(self) -> Scenario:
        """The scenario; raises InputError if its fields are inconsistent."""
        return _shared_scenario(json.dumps({name: getattr(self.config, name) for name in SCENARIO}, default=str))

    def prior_spec(self) -> PriorSpec | None:
        """Return the prior; None if there is none."""
        return _prior(self.config.prior)

    def settings(self) -> dict[str, Any]:
        """Return all settings of the method, defaults included, validated."""
        name, given = self.config.method["name"], {k: v for k, v in self.config.method.items() if k != "name"}
        if name in REFERENCES:
            for key, value in given.items():
                raise InputError(f"method.{key}", value, f"not a field; {name} has no settings")
            return {}
        for key, default in default_settings(name).items():
            if isinstance(given.get(key), bool) and not isinstance(default, bool):
                raise InputError(f"method.{key}", given[key], "not true or false")
        method = make_method(name, given)
        return {key: getattr(method, key) for key in default_settings(name)}

    def cell(self) -> Cell:
        """Return the cell; raises InputError for an inconsistent scenario or setting."""
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
        if isinstance(value, bool) and bool not in declared()[name].types:
            raise InputError(name, value, "a number or a name, not true or false")
    return validated(Config, {"from_" if name == "from" else name: value for name, value in content.items()}, WRITTEN)


@lru_cache(maxsize=1024)
def _shared_scenario(stated: str) -> Scenario:
    """Return the scenario of a JSON text; the cells of all methods share it, and what it caches."""
    return scenario_from(json.loads(stated))


def scenario_from(content: Mapping[str, Any]) -> Scenario:
    """Return the scenario of a composed configuration; raises InputError.

    The declaration of each field of the scenario states its path in the configuration.
    """
    check_numbers({name: content[name] for name in SCENARIO[:3]})
    check_system(content["system"].get("kind"), content["system"].get("options"))
    kind = declaration.Scenario
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
    for name, value in system.items():
        known = [path.removeprefix("system.") for path in paths.values() if path.startswith("system.")]
        remedy = f"not a field; {did_you_mean(name, known)}fields: {', '.join(known)}"
        raise InputError(f"system.{name}", value, remedy)
    return validated(kind, values, paths)


def _prior(content: Mapping[str, Any]) -> PriorSpec | None:
    for name, value in (content["sd_by_kind"] or {}).items():
        if name not in KINDS:
            raise InputError(f"prior.sd_by_kind.{name}", value, f"not a field; fields: {', '.join(KINDS)}")
    return validated(PriorSpec, content, "prior") if content["sd_by_kind"] is not None else None


def _disturbance(content: Mapping[str, Any]) -> Disturbance | None:
    settings = {name: value for name, value in content.items() if name != "kind" and value is not None}
    if content["kind"] == "none" and not settings:
        return None
    return Disturbance.from_dict({"kind": content["kind"], **settings})
