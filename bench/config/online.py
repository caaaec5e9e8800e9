"""The scenarios of the online track, read from ``conf/online``, and those made of any file of ``conf/system``."""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

import yaml

from bench.config.choices import check_choice, own_file
from bench.config.drawn import drawn_scenario
from bench.config.files import read_yaml
from bench.config.own_file import read_own_system
from bench.errors import InputError, did_you_mean
from bench.online.course import Course
from bench.online.forces import HeldForce
from bench.online.scenario import OnlineScenario
from bench.scenario.declaration import validated
from bench.systems import make_system


def online_track() -> dict[str, Any]:
    """The content of ``conf/online/track.yaml``."""
    text = files("conf").joinpath("online", "track.yaml").read_text(encoding="utf-8")
    content = yaml.safe_load(text)
    assert isinstance(content, dict)
    return content


def scenario_names() -> list[str]:
    """The scenarios of Table 10, in its order."""
    return list(online_track()["scenarios"])


def online_scenario(name: str, changes: Mapping[str, Any] | None = None) -> OnlineScenario:
    """A scenario of the track, with fields that differ; raises InputError that names the field."""
    content = online_track()
    if name not in content["scenarios"]:
        near = did_you_mean(name, scenario_names())
        raise InputError("scenario", name, f"{near}one of {', '.join(scenario_names())}")
    stated = {**content["base"], **content["scenarios"][name], **(changes or {}), "label": name}
    return validated(OnlineScenario, stated, {key: f"online.{key}" for key in stated} | {"": "online"})


A_CYCLE = 20.0
"""Samples a cycle of an own scenario, where its rate is not said."""
SAMPLES = 2000
LARGEST = 1e9
"""Of the numbers of an own scenario."""
VARYING = "system.varying."
"""What stands before the parameter whose course is said on the command line."""


def own_scenarios(system: str, stated: Mapping[str, str], varying: Mapping[str, str]) -> list[OnlineScenario]:
    """Scenarios of a file of ``conf/system``, one for each combination of the courses; raises InputError.

    Args:
        system: its name.
        stated: ``snr``, ``samples``, ``rate``, ``force`` as text; an empty one leaves what is usual.
        varying: by parameter its courses as text: a kind, or ``{kind: step, change: -0.3}``, several with commas.
    """
    check_choice("system", system)
    found = system_content(system)
    made = make_system(found["kind"], found["options"])
    base: dict[str, Any] = {"system": found["kind"]} | {name: found[name] for name in ("options", "parameters")}
    frequency = _first_frequency(made, found["parameters"])
    base["rate"] = _number("rate", stated["rate"], A_CYCLE * frequency)
    base["samples"] = round(_number("samples", stated["samples"], float(SAMPLES)))
    base["snr_db"] = _number("snr", stated["snr"], 20.0)
    force = {"kind": "multisine", "low_hz": 0.2 * frequency, "high_hz": 2.0 * frequency}
    force |= _mapping("force", stated["force"], "kind")
    base["forces"] = [validated(HeldForce, force, {key: f"force.{key}" for key in force} | {"": "force"})]
    for name in varying:
        if name not in made.names:
            near = did_you_mean(name, list(made.names))
            raise InputError(
                f"{VARYING}{name}", varying[name], f"{near}parameters of {system}: {', '.join(made.names)}"
            )
    courses = {name: _courses(name, text) for name, text in varying.items()}
    scenarios = []
    for chosen in itertools.product(*courses.values()):
        label = " ".join([system, *(f"{name} {course.kind}" for name, course in zip(courses, chosen, strict=True))])
        own = {**base, "varying": dict(zip(courses, chosen, strict=True)), "label": label.replace(" ", "_")}
        scenarios.append(validated(OnlineScenario, own, {key: key for key in own} | {"": "online"}))
    return scenarios


def system_content(name: str) -> dict[str, Any]:
    """A file of ``conf/system`` over those that it starts from."""
    drawn = drawn_scenario(name)
    if own_file("system", name):
        stated = read_own_system(os.path.expanduser(name))
    else:
        stated = dict(drawn.system) if drawn else read_yaml("system", name)
    for base in stated.get("defaults", []):
        if isinstance(base, str) and base != "_self_":
            stated = {**system_content(base), **stated}
    return {"kind": "sdof", "options": {}, **stated}


def _first_frequency(system: Any, parameters: Mapping[str, float]) -> float:
    """Of the first mass on the first spring (Hz), which sets the scale of rate and force."""
    size = {kind: next((parameters[p.name] for p in system.parameters if p.kind == kind), 0.0)
            for kind in ("mass", "stiffness")}  # fmt: skip
    return math.sqrt(size["stiffness"] / size["mass"]) / (2.0 * math.pi) if min(size.values()) > 0 else 1.0


def _number(field: str, text: str, usual: float) -> float:
    try:
        value = float(text) if text else usual
    except ValueError:
        value = math.nan
    if not abs(value) <= LARGEST:
        raise InputError(field, text, f"a number of at most {LARGEST:g}")
    return value


def _courses(name: str, text: str) -> list[Course]:
    """The courses of a parameter: kinds, or mappings, with commas between them."""
    parts = _yaml(f"{VARYING}{name}", f"[{text}]")
    found = []
    for part in parts:
        stated = _mapping(f"{VARYING}{name}", part, "kind")
        found.append(
            validated(Course, stated, {key: f"{VARYING}{name}.{key}" for key in stated} | {"": VARYING + name})
        )
    return found


def _mapping(field: str, stated: Any, of: str) -> dict[str, Any]:
    """A mapping, or a text that stands for its entry ``of``."""
    if isinstance(stated, str) and stated.startswith("{"):
        stated = _yaml(field, stated)
    if isinstance(stated, dict):
        return stated
    return {of: stated} if stated else {}


def _yaml(field: str, text: str) -> Any:
    try:
        return yaml.safe_load(text)
    except yaml.YAMLError:
        raise InputError(field, text, "a kind, or {kind: step, change: -0.3}") from None
