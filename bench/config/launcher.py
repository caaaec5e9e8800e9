"""What a command line says of a launcher of Hydra's: which one, and options of it, and nothing else of Hydra."""

from __future__ import annotations

from collections.abc import Sequence

from bench.errors import InputError

CHOICE, OPTION = "hydra/launcher", "hydra.launcher."
OURS = "local"
"""The launcher that is none: this machine's cores."""


def of_launcher(text: str) -> bool:
    """Whether an argument is one of Hydra's own: ``hydra/launcher=ray``, ``hydra.launcher.partition=debug``."""
    return text.lstrip("+~").startswith(("hydra/", "hydra."))


def check_launcher(texts: Sequence[str]) -> None:
    """Raise InputError for anything but a launcher that is there and options of it.

    An option sets a value. What a launcher is made of, ``_target_``, is no option: it would be called.
    """
    chosen = None
    for text in texts:
        key, equals, value = text.partition("=")
        plain = key.lstrip("+")
        if plain == CHOICE:
            chosen = value
        elif not plain.startswith(OPTION) or not equals:
            raise InputError(key, value, f"of Hydra only {CHOICE}=<name> and {OPTION}<option>=<value> are read")
        elif "_target_" in text or "${" in text:
            raise InputError(key, value, f"{CHOICE}=<name> says what is called; an option is a plain value")
    if chosen is not None:
        _check_choice(chosen)
    options = [text.partition("=") for text in texts if not text.lstrip("+").startswith(CHOICE)]
    if options and chosen is None:
        raise InputError(options[0][0], options[0][2], f"an option of a launcher: name that too, by {CHOICE}=")


def _check_choice(value: str) -> None:
    """Raise InputError for a launcher that is not installed."""
    from hydra.core.config_store import ConfigStore
    from hydra.core.plugins import Plugins

    Plugins.instance()  # launchers register themselves as it looks for them
    known = sorted({OURS, *(name.removesuffix(".yaml") for name in ConfigStore.instance().list("hydra/launcher"))})
    if value not in known:
        more = "(pip install 'vibration-bench[ray]' or '[slurm]' for more)"
        raise InputError(CHOICE, value, f"known: {', '.join(known)} {more}")
