"""Composition of configuration groups by Hydra; all groups of a sweep are composed in one call."""

from __future__ import annotations

import itertools
import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from bench.config.choices import content, name_for_hydra
from bench.config.overrides import DELETED
from bench.errors import InputError

WORDS = ("null", "true", "false", "nan", "inf")
"""Words that Hydra reads as text only in quotes."""
HYDRA_GROUPS = ("job_logging", "hydra_logging", "output", "help", "hydra_help", "launcher", "sweeper", "env")
"""Groups of Hydra's own configuration that the composition of parts does not need."""


@dataclass(frozen=True)
class Part:
    """A choice of a group, with the overrides of its fields.

    ``name`` is the name of the choice in Hydra; ``fields`` are overrides in Hydra's grammar, in which ``{0}`` stands
    for the path of the part in the configuration; ``written`` is the choice as the user wrote it.
    """

    group: str
    name: str
    fields: tuple[str, ...] = ()
    written: str = field(default="", compare=False)

    def overrides(self, path: str) -> list[str]:
        """Return the Hydra overrides that put the part at a path of the configuration."""
        return [f"+{self.group}@{path}={self.name}", *(text.replace("{0}", path, 1) for text in self.fields)]


_COMPOSED: dict[Part, dict[str, Any]] = {}


def part_of(group: str, choice: Any, below: Mapping[str, Any] | None = None) -> Part:
    """Return the part for a choice, with the values of fields below its group; raises InputError."""
    fields = (
        f"~{{0}}.{key}" if value is DELETED else f"++{{0}}.{key}={literal(value)}"
        for key, value in (below or {}).items()
    )
    return Part(group, name_for_hydra(group, choice), tuple(fields), str(choice))


def composed(parts: Collection[Part]) -> Mapping[Part, dict[str, Any]]:
    """Return the content of each part as plain values; raises InputError.

    The values are cached and shared: do not change them. Hydra composes only the choices that have ``defaults`` or
    overrides.
    """
    by_hydra = []
    for part in dict.fromkeys(parts):
        if part not in _COMPOSED:
            stated = content(part.group, part.name)
            if part.fields or "defaults" in stated:
                by_hydra.append(part)
            else:
                _COMPOSED[part] = stated
    if by_hydra:
        _COMPOSED.update(zip(by_hydra, _compose(by_hydra), strict=True))
    return _COMPOSED


def content_of(group: str, choice: Any) -> dict[str, Any]:
    """Return the composed content of one choice; raises InputError."""
    part = part_of(group, choice)
    return composed([part])[part]


def _compose(parts: Sequence[Part]) -> list[dict[str, Any]]:
    from hydra import compose
    from hydra.errors import HydraException
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException

    from bench.config.sources import hydra_ready

    unused = [f"~hydra/{group}" for group in HYDRA_GROUPS]
    lines = [part.overrides(f"part{number}") for number, part in enumerate(parts)]
    try:
        with hydra_ready():
            contents = OmegaConf.to_container(compose(None, [*unused, *itertools.chain(*lines)]), resolve=True)
    except (HydraException, OmegaConfBaseException) as error:
        if len(parts) > 1:
            return [_compose([part])[0] for part in parts]  # one of these raises, with its name
        raise _bad_input(parts[0], error) from None
    assert isinstance(contents, dict)
    return [contents[f"part{number}"] for number in range(len(parts))]


def _bad_input(part: Part, error: Exception) -> InputError:
    """Convert an error of Hydra for one part into the terms of the command line."""
    reason = str(error).splitlines()[0].replace("part0", part.group).replace(part.name, part.written)
    if not part.fields:
        return InputError(part.group, part.written, reason)
    key, _, value = part.fields[-1].lstrip("+~").replace("{0}", part.group, 1).partition("=")
    return InputError(key, value, reason)


def literal(value: Any) -> str:
    """Return a value in Hydra's override grammar."""
    if isinstance(value, list | tuple):
        return f"[{','.join(map(literal, value))}]"
    if isinstance(value, Mapping):
        return f"{{{','.join(f'{key}:{literal(item)}' for key, item in value.items())}}}"
    if value is None or isinstance(value, bool):
        return json.dumps(value)
    if not isinstance(value, str) or (value.isidentifier() and value.lower() not in WORDS):
        return str(value)
    from hydra.core.override_parser.types import Quote, QuotedString

    return QuotedString(value, Quote.single).with_quotes()
