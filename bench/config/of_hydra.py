"""Hydra's own fields on a command line: a launcher and its options, the folder of a run, its log."""

from __future__ import annotations

import logging
import sys
from collections.abc import Mapping, Sequence
from typing import Any

from bench.errors import InputError, check_name

CHOICE, OPTION = "hydra/launcher", "hydra.launcher."
FOLDERS, VERBOSE = ("hydra.run.dir", "hydra.sweep.dir"), "hydra.verbose"
READ = f"of Hydra {CHOICE}=, {OPTION}<option>=, {'=, '.join(FOLDERS)}= and {VERBOSE}= are read"
OURS = "local"
"""The launcher that is none: this machine's cores."""


def is_of_hydra(text: str) -> bool:
    """Return whether an argument is one of Hydra's own: ``hydra/launcher=ray``, ``hydra.launcher.partition=debug``."""
    return text.lstrip("+~").startswith(("hydra/", "hydra."))


def check_of_hydra(texts: Sequence[str]) -> None:
    """Raise InputError for a field of Hydra's that has no effect here, and for a launcher that is not installed.

    An option of a launcher sets a value. What it is made of, ``_target_``, is no option: it would be called.
    """
    launchers = [text.partition("=")[2] for text in texts if text.lstrip("+").partition("=")[0] == CHOICE]
    for text in texts:
        key, equals, value = text.partition("=")
        plain = key.lstrip("+")
        if not equals or not (plain.startswith(OPTION) or plain in (CHOICE, *FOLDERS, VERBOSE)):
            raise InputError(key, value, READ)
        if "_target_" in text or "${" in text:
            raise InputError(key, value, f"{CHOICE}=<name> says what is called; an option is a plain value")
        if plain in FOLDERS and not value:
            raise InputError(key, value, "name a folder")
        if plain.startswith(OPTION) and not launchers:
            raise InputError(key, value, f"an option of a launcher: name that too, by {CHOICE}=")
    for name in launchers:
        from hydra.core.config_store import ConfigStore
        from hydra.core.plugins import Plugins

        Plugins.instance()  # launchers register themselves as it looks for them
        known = {OURS, *(name.removesuffix(".yaml") for name in ConfigStore.instance().list("hydra/launcher"))}
        check_name(CHOICE, name, sorted(known), " (pip install 'vibration-bench[ray]' or '[slurm]' for more)")


def prepared(texts: Sequence[str], overrides: Mapping[str, list[Any]]) -> Mapping[str, list[Any]]:
    """Return overrides with the store in the folder that is named to Hydra, and start the log where it is asked for."""
    for key, _, value in (text.lstrip("+").partition("=") for text in texts):
        if key in FOLDERS and "store" not in overrides:
            overrides = {**overrides, "store": [f"{value.strip(chr(39))}/rows"]}
        if key == VERBOSE and value != "false":
            logging.basicConfig(stream=sys.stderr)
            for name in [None] if value == "true" else value.strip("[]").split(","):
                logging.getLogger(name).setLevel(logging.DEBUG)
    return overrides
