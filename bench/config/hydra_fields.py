"""Hydra's own fields on the command line: the launcher and its options."""

from __future__ import annotations

from collections.abc import Sequence

from bench.errors import InputError, check_name

CHOICE, OPTION = "hydra/launcher", "hydra.launcher."
SUPPORTED = f"not supported; of Hydra's fields {CHOICE}= and {OPTION}<option>= are"
LOCAL = "local"
"""Name of the default: worker processes on this machine, without a launcher of Hydra."""


def is_of_hydra(text: str) -> bool:
    """Return whether an argument sets a field of Hydra: ``hydra/launcher=ray``, ``hydra.launcher.partition=debug``."""
    return text.lstrip("+~").startswith(("hydra/", "hydra."))


def check_of_hydra(texts: Sequence[str]) -> None:
    """Raise InputError for unsupported fields of Hydra, and for a launcher that is not installed.

    ``_target_`` is rejected, since Hydra would call the function that it names.
    """
    launchers = [text.partition("=")[2] for text in texts if text.lstrip("+").partition("=")[0] == CHOICE]
    for text in texts:
        key, equals, value = text.partition("=")
        plain = key.lstrip("+")
        if not equals or not (plain.startswith(OPTION) or plain == CHOICE):
            raise InputError(key, value, SUPPORTED)
        if "_target_" in text or "${" in text:
            raise InputError(key, value, f"give a plain value; {CHOICE}=<name> selects the launcher")
        if plain.startswith(OPTION) and not launchers:
            raise InputError(key, value, f"an option of a launcher requires {CHOICE}=<name>")
    for name in launchers:
        from hydra.core.config_store import ConfigStore
        from hydra.core.plugins import Plugins

        Plugins.instance()  # importing the plugins registers the launchers
        known = {LOCAL, *(name.removesuffix(".yaml") for name in ConfigStore.instance().list("hydra/launcher"))}
        check_name(CHOICE, name, sorted(known), " (pip install 'vibration-bench[ray]' or '[slurm]' for more)")
