"""The scenarios of the online track, read from ``conf/online``, and one made of a file of ``conf/system``."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files
from typing import Any

import yaml

from bench.config.suggest import did_you_mean
from bench.errors import InputError
from bench.online.scenario import OnlineScenario
from bench.scenario.declaration import validated


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
