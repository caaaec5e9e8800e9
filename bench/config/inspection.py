"""Hydra's own displays of a cell's configuration: ``--cfg``, ``--info``, ``--hydra-help``, shell completion."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from unittest.mock import patch

from bench.config.choices import check_choice, default_choices, name_for_hydra
from bench.config.composition import content_of
from bench.config.declaration import written
from bench.config.overrides import DELETED, Overrides, literal
from bench.config.sources import register_plugins
from bench.errors import InputError

PROGRAM = "vibration-bench"
"""The installed command, whose arguments the shell completes."""


def hydra_overrides(overrides: Overrides) -> list[str]:
    """Return the overrides with which Hydra composes the configuration of one cell; raises InputError."""
    lines = []
    for field, values in overrides.items():
        if len(values) > 1:
            raise InputError(field, written(values), "give one value to show one cell; dry_run=true lists a sweep")
        value = values[0]
        if field == "system":
            check_choice(field, value)
            value = name_for_hydra(field, value)
        lines.append(f"~{field}" if value is DELETED else f"{'++' if '.' in field else ''}{field}={literal(value)}")
    if "prior" not in overrides:
        prior = content_of("system", overrides.get("system", [default_choices()["system"]])[0]).get("default_prior")
        lines += [f"prior={prior}"] if prior else []
    return lines


def ask_hydra(options: Sequence[str], words: Sequence[str]) -> int:
    """Run Hydra with its own command-line options, and return its exit status; raises InputError."""
    import hydra
    from hydra.errors import HydraException
    from omegaconf.errors import OmegaConfBaseException

    register_plugins()
    task = hydra.main(config_path="pkg://conf", config_name="config", version_base="1.3")(lambda config: None)
    with patch.object(sys, "argv", [PROGRAM, *options, *words]), patch.dict(os.environ, {"HYDRA_FULL_ERROR": "1"}):
        try:
            task()
        except SystemExit as end:
            return int(end.code or 0)
        except (HydraException, OmegaConfBaseException, ValueError) as error:
            raise InputError("option", " ".join(options), str(error).splitlines()[0]) from None
    return 0
