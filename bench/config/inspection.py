"""Hydra's own displays of a cell's configuration: ``--cfg``, ``--info``, ``--hydra-help``, shell completion.

Its plugins here add the configuration source ``bench://`` to the files of ``conf``: registered methods with their
default settings, development scenarios, drawn scenarios, scenario files of the user, and the fields of a run.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from unittest.mock import patch

from hydra.core.config_search_path import ConfigSearchPath
from hydra.core.object_type import ObjectType
from hydra.core.plugins import Plugins
from hydra.plugins.config_source import ConfigResult, ConfigSource
from hydra.plugins.search_path_plugin import SearchPathPlugin
from omegaconf import OmegaConf

from bench.config.choices import GROUPS, check_choice, choices, content, default_choices, is_choice, name_for_hydra
from bench.config.composition import content_of
from bench.config.declaration import written
from bench.config.fields import defaults
from bench.config.overrides import DELETED, Overrides, literal
from bench.errors import InputError

PROGRAM = "vibration-bench"
"""The installed command, whose arguments the shell completes."""


FIELDS = "fields"
"""Name of the configuration with the defaults of the fields of a run."""


class BenchSource(ConfigSource):
    """Configuration source with the choices of :mod:`bench.config.choices`."""

    @staticmethod
    def scheme() -> str:
        return "bench"

    def available(self) -> bool:
        return True

    def load_config(self, config_path: str) -> ConfigResult:
        group, _, name = config_path.removesuffix(".yaml").rpartition("/")
        values = content(group, name) if group else defaults()
        return ConfigResult(self.provider, self.full_path(), OmegaConf.create(values), {"package": None})

    def is_group(self, config_path: str) -> bool:
        return config_path in ("", *GROUPS)

    def is_config(self, config_path: str) -> bool:
        group, _, name = config_path.removesuffix(".yaml").rpartition("/")
        return is_choice(group, name) if group in GROUPS else (group, name) == ("", FIELDS)

    def list(self, config_path: str, results_filter: ObjectType | None) -> list[str]:
        return [] if results_filter == ObjectType.GROUP or config_path not in GROUPS else choices(config_path)


class BenchSearchPath(SearchPathPlugin):
    """Appends ``bench://`` to Hydra's search path."""

    def manipulate_search_path(self, search_path: ConfigSearchPath) -> None:
        search_path.append("bench", "bench://")


def register_plugins() -> None:
    """Register both plugins with Hydra."""
    for plugin in (BenchSource, BenchSearchPath):
        Plugins.instance().register(plugin)


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
