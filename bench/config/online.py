"""Scenarios of the online track, from ``conf/online/track.yaml``, or made from any file of ``conf/system``."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any

from bench.config.choices import check_choice
from bench.config.composition import content_of
from bench.config.files import read_yaml
from bench.errors import check_name
from bench.online.course import Course
from bench.online.forces import HeldForce
from bench.online.scenario import OnlineScenario
from bench.scenario.declaration import validated
from bench.systems import System, make_system

SAMPLES_PER_CYCLE, SAMPLES, SNR_DB = 20.0, 2000, 20.0
"""Defaults of the scenarios that are made from a file of ``conf/system``."""
VARYING = "system.varying."
"""Prefix of a time-varying parameter on the command line."""


def online_track() -> dict[str, Any]:
    """Return the content of ``conf/online/track.yaml``."""
    return read_yaml("online", "track")


def scenario_names() -> list[str]:
    """Return the names of the scenarios, in the order of Table 10."""
    return list(online_track()["scenarios"])


def online_scenario(name: str, changes: Mapping[str, Any] | None = None) -> OnlineScenario:
    """Return a scenario of the track, with changed fields; raises InputError that names the field."""
    check_name("scenario", name, scenario_names())
    content = online_track()
    stated = {**content["base"], **content["scenarios"][name], **(changes or {}), "label": name}
    return validated(OnlineScenario, stated, "online")


def scenarios_from_system(
    system: str,
    varying: Mapping[str, Sequence[Any]],
    force: Mapping[str, Any] | None = None,
    snr: float | None = None,
    samples: int | None = None,
    rate: float | None = None,
) -> list[OnlineScenario]:
    """Return the scenarios made from a file of ``conf/system``, one per combination of courses.

    Args:
        system: Name of the file.
        varying: Courses by parameter; a course is its kind, or a mapping of its fields.
        force: Fields of the force; by default a multisine around the first natural frequency.
        snr: Signal-to-noise ratio, dB.
        samples: Number of samples.
        rate: Sampling rate, 1/s; by default 20 samples per cycle.

    Raises:
        InputError: The name of the system or a field is wrong.
    """
    check_choice("system", system)
    content = {"options": {}, **content_of("system", system)}
    model = make_system(content["kind"], content["options"])
    hertz = _first_frequency(model, content["parameters"])
    multisine = {"kind": "multisine", "low_hz": 0.2 * hertz, "high_hz": 2.0 * hertz}
    base: dict[str, Any] = {
        "system": content["kind"],
        "options": content["options"],
        "parameters": content["parameters"],
        "rate": rate or SAMPLES_PER_CYCLE * hertz,
        "samples": samples or SAMPLES,
        "snr_db": SNR_DB if snr is None else snr,
        "forces": [validated(HeldForce, {**multisine, **(force or {})}, "force")],
    }
    for name in varying:
        check_name(f"{VARYING}{name}", name, model.names, f", the parameters of {system}")
    courses = [[_course(name, stated) for stated in several] for name, several in varying.items()]
    scenarios = []
    for chosen in itertools.product(*courses):
        changing = dict(zip(varying, chosen, strict=True))
        label = "_".join([system, *(f"{name}_{course.kind}" for name, course in changing.items())])
        stated = {**base, "varying": changing, "label": label}
        scenarios.append(validated(OnlineScenario, stated, {"snr_db": "snr", "": "online"}))
    return scenarios


def _first_frequency(system: System, parameters: Mapping[str, float]) -> float:
    """Return the frequency of the first mass on the first spring (Hz), for the default rate and force."""
    size = {kind: next((parameters[p.name] for p in system.parameters if p.kind == kind), 0.0)
            for kind in ("mass", "stiffness")}  # fmt: skip
    return math.sqrt(size["stiffness"] / size["mass"]) / (2.0 * math.pi) if min(size.values()) > 0 else 1.0


def _course(name: str, stated: Any) -> Course:
    return validated(Course, stated if isinstance(stated, Mapping) else {"kind": stated}, f"{VARYING}{name}")
