"""The scenarios of the modal track, read from ``conf/modal``."""

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
    """Return the scenarios of Table 12, in its order."""
    return list(modal_track()["scenarios"])


def modal_scenario(name: str) -> ModalScenario:
    """Return a scenario of the track; raises InputError for another name."""
    check_name("scenario", name, modal_scenario_names())
    content = modal_track()
    stated = content["scenarios"][name]
    base = content["blows" if stated.get("blows") else "free_decays"]
    return validated(ModalScenario, {**base, **stated, "label": name}, "modal")
