"""Hydra plugins that add the configuration source ``bench://`` to the files of ``conf``.

``bench://`` serves registered methods with their default settings, development scenarios, drawn scenarios, scenario
files of the user, and the fields of a run.
"""

from __future__ import annotations

from hydra.core.config_search_path import ConfigSearchPath
from hydra.core.object_type import ObjectType
from hydra.core.plugins import Plugins
from hydra.plugins.config_source import ConfigResult, ConfigSource
from hydra.plugins.search_path_plugin import SearchPathPlugin
from omegaconf import OmegaConf

from bench.config.choices import GROUPS, choices, content, is_choice
from bench.config.fields import defaults

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
