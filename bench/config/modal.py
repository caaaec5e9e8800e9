"""Scenarios of the modal track, from ``conf/modal/track.yaml``."""

from __future__ import annotations

from typing import Any

from bench.config.files import read_yaml
from bench.errors import check_name
from bench.modal.scenario import ModalScenario
from bench.scenario.declaration import validated


def modal_track() -> dict[str, Any]:
    """Return the content of ``conf/modal/track.yaml``."""
    return read_yaml("modal", "track")


def modal_scenario_names() -> list[str]:
    """Return the names of the scenarios, in the order of Table 12."""
    return list(modal_track()["scenarios"])


def modal_scenario(name: str) -> ModalScenario:
    """Return a scenario of the track; raises InputError for an unknown name."""
    check_name("scenario", name, modal_scenario_names())
    content = modal_track()
    stated = content["scenarios"][name]
    base = content["blows" if stated.get("blows") else "free_decays"]
    return validated(ModalScenario, {**base, **stated, "label": name}, "modal")
