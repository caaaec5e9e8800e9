"""What Hydra itself shows of one cell's configuration: ``--cfg``, ``--info``, ``--hydra-help``, shell completion."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from typing import Any
from unittest.mock import patch

from bench.config.choices import default_choices, is_choice, own_file, register_own_file
from bench.config.composition import composed, literal, part_of
from bench.config.declaration import written
from bench.config.overrides import DELETED, Overrides
from bench.config.sources import hydra_ready, register_plugins
from bench.errors import InputError

PROGRAM = "vibration-bench"
"""The installed command, whose words the shell completes."""


def in_place(overrides: Overrides) -> list[str]:
    """Return overrides of Hydra that compose one cell in its own configuration; raises InputError."""
    lines = []
    for field, values in overrides.items():
        if len(values) > 1:
            raise InputError(field, written(values), "one cell is shown; a sweep by dry_run=true")
        (value,) = values
        if value is DELETED:
            lines.append(f"~{field}")
            continue
        if field == "system" and own_file(field, value):
            value = register_own_file(str(value))
        if field == "system" and not is_choice(field, str(value)):
            raise InputError(field, value, "it has no file of conf/system, whose content could be shown")
        lines.append(f"{'++' if '.' in field else ''}{field}={literal(value)}")
    if "prior" not in overrides:
        system = part_of("system", overrides.get("system", [default_choices()["system"]])[0], {})
        prior = composed([system])[system].get("default_prior")
        lines += [f"prior={prior}"] if prior else []
    return lines


def compose_in_place(overrides: Overrides) -> dict[str, Any]:
    """Return what Hydra composes of one cell; raises InputError."""
    from hydra import compose
    from omegaconf import OmegaConf

    lines = in_place(overrides)
    with hydra_ready():
        return OmegaConf.to_container(compose("config", lines), resolve=True)  # type: ignore[return-value]


def show(options: Sequence[str], overrides: Overrides, of_hydra: Sequence[str] = ()) -> int:
    """Have Hydra print what options ask for of one cell; raises InputError."""
    return complete(options, [*in_place(overrides), *of_hydra])


def complete(options: Sequence[str], words: Sequence[str]) -> int:
    """Hand the words of a command line to Hydra as they are; raises InputError."""
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
