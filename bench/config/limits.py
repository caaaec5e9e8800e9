"""What a composed group may not hold: fields that do not exist, and numbers that cannot be computed with."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any, get_args

from bench.config.suggest import did_you_mean
from bench.entrants.registry import default_settings
from bench.errors import InputError
from bench.scenario import scenario as declared
from bench.scenario.declaration import declared_types
from bench.scenario.disturbance import kinds
from bench.scenario.scenario import PriorSpec, config_path
from bench.systems import load_system, make_system
from bench.systems.contract import Kind

LEAST, MOST = 1e-15, 1e15
"""Of every number of a scenario but 0, whatever it measures (SI units): nothing that vibrates is outside."""
COUNTS = {"samples": 1_000_000, "tones": 10_000, "n": 1000}
"""The most of what a number counts, by its name: samples of a force, sine waves in it, masses of a chain."""
FLAGS = {f"prior.{f.name}" for f in fields(PriorSpec) if declared_types(PriorSpec)[f.name] is bool}
FREE = ("system.options.",)
"""Where a system says itself what is true or false."""


def check_numbers(content: Mapping[str, Any]) -> None:
    """Raise InputError for a number of a scenario's groups that is none, or beyond all limits.

    What a field of a certain name may be is said where it is declared; this is what all have in common, and keeps what
    cannot be computed from being tried.
    """
    for path, value in _leaves(content):
        if isinstance(value, bool):
            if path not in FLAGS and not path.startswith(FREE):
                raise InputError(path, value, "a number or a name, not true or false")
        elif isinstance(value, int | float) and value == value:
            _check_size(path, value)


def _check_size(path: str, value: float) -> None:
    most = COUNTS.get(path.rpartition(".")[2], MOST)
    if abs(value) > most and abs(value) != float("inf"):  # of what is infinite its declaration speaks
        raise InputError(path, value, f"at most {most:g}")
    if 0 < abs(value) < LEAST:
        raise InputError(path, value, f"at least {LEAST:g}")


def _leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Every value that holds no others, with its path; the items of a list have the path of the list."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from _leaves(item, f"{path}.{key}" if path else str(key))
    elif isinstance(value, list | tuple):
        for item in value:
            yield from _leaves(item, path)
    else:
        yield path, value


def check_names(group: str, content: Mapping[str, Any]) -> None:
    """Raise InputError for a field of a composed group, or of what lies below it, that does not exist."""
    if group == "method":
        _check_known("method", content, ["name", *default_settings(content["name"])])
    elif group == "system":
        paths = [config_path(f) for f in fields(declared.Scenario)]
        _check_known("system", content, [path[7:] for path in paths if path.startswith("system.")] + ["default_prior"])
        check_system(content.get("kind"), content.get("options") or {}, content.get("parameters"))
    elif group == "prior":
        _check_known("prior", content, [f.name for f in fields(PriorSpec)])
        _check_known("prior.sd_by_kind", content["sd_by_kind"] or {}, get_args(Kind))
    elif group == "disturbance" and content["kind"] in ("none", *kinds()):
        own = [] if content["kind"] == "none" else [f.name for f in fields(kinds()[content["kind"]])]
        _check_known("disturbance", content, ["kind", *own])


def check_system(kind: Any, options: Any, parameters: Any = None) -> None:
    """Raise InputError for an option or a parameter that a system does not have, and for a count that is not whole."""
    if not isinstance(kind, str) or not isinstance(options, Mapping):
        return  # its declaration speaks of these
    of = load_system(kind)
    if is_dataclass(of):
        types = declared_types(of)
        _check_known("system.options", options, [f.name for f in fields(of)])
        for name, value in options.items():
            if types[name] is int and type(value) is not int:
                raise InputError(f"system.options.{name}", value, "a whole number")
    if isinstance(parameters, Mapping) and set(parameters) > set(names := make_system(kind, options).names):
        _check_known("system.parameters", parameters, names)


def _check_known(group: str, given: Mapping[str, Any], known: Sequence[str]) -> None:
    for name in given:
        if name not in known:
            listed = [name for name in known if name not in ("name", "kind")]
            remedy = f"there are {', '.join(listed)}" if listed else "there is none"
            raise InputError(f"{group}.{name}", given[name], f"no such field; {did_you_mean(name, listed)}{remedy}")
