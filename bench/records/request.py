"""What is asked of measured records: the files, how to read them, the system, and the methods."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from bench.config.choices import choices, is_user_file
from bench.config.experiment import sweep
from bench.config.fields import GROUPS, MODAL, Config
from bench.config.overrides import Overrides
from bench.config.records import default_method
from bench.config.schema import Job, config_from
from bench.contract.modal import MOST_MODES, ModalIdentifier
from bench.entrants.modal import make_modal, registered_modal
from bench.entrants.reference import REFERENCES
from bench.entrants.registry import method_names
from bench.errors import InputError
from bench.records.reading import ReadOptions
from bench.systems.sums import FIRST, SYSTEMS, TERMS

LISTS = ("data", "columns", "units")
"""Fields in which a comma separates the parts of one value."""
AUTO = "auto"
ALL = "all"
VISCOUS = "sdof"


@dataclass(frozen=True)
class Request:
    """Files of one rig, how to read them, and a job for each method; ``system`` as it was written."""

    files: tuple[Path, ...]
    options: ReadOptions
    system: str
    jobs: tuple[Job, ...]

    @property
    def job(self) -> Job:
        """What all methods share."""
        return self.jobs[0]


@dataclass(frozen=True)
class ModalRequest:
    """Files, how to read them, and the modal methods by name; ``count`` of modes, None for as many as there are.

    Without a method the data decide which it is.
    """

    files: tuple[Path, ...]
    options: ReadOptions
    methods: Mapping[str, ModalIdentifier]
    count: int | None
    band: tuple[float, float] | None
    config: Config


def request_of(overrides: Overrides) -> Request:
    """The request that overrides make.

    Raises:
        InputError: For what makes no sense, before any file is read.
    """
    given = _joined(overrides)
    _check(given)
    system = str(given.pop("system", [VISCOUS])[0])
    if _of_configuration(system):
        given["system"] = [system]
    elif any(key.startswith("system.") for key in given):
        raise InputError("system", system, "its terms have no further fields; leave system.<field> out")
    if given.get("method") == [ALL]:
        given["method"] = [name for name in method_names() if name not in REFERENCES]
    if "method" not in given and "experiment" not in given:
        given["method"] = [default_method()]
    jobs = sweep(given, measured=True)
    config = jobs[0].config
    options, files = _options(config), _files(config)
    if options.decimate > 1 and config.start is not None:
        raise InputError("start", config.start, "decimate= leaves the first samples out; leave start= out, too")
    spec = jobs[0].prior_spec() if "prior" in given else None
    if spec is not None and (spec.wrong or spec.draws != "nominal"):
        field, value = ("prior.draws", spec.draws) if spec.draws != "nominal" else ("prior", spec.name)
        raise InputError(field, value, "it is of simulated data; nominal.<p>= states your values")
    return Request(files, options, system, tuple(jobs))


def modal_request_of(overrides: Overrides) -> ModalRequest:
    """The request that overrides with ``modes=`` make; raises InputError before any file is read."""
    given = _joined(overrides)
    _check_single(given)
    for key in (key for key in given if key.partition(".")[0] not in MODAL and given[key] != [None]):
        raise InputError(key, given[key][0], "does not go with modes=; leave one of the two out")
    settings = {key.removeprefix("method."): given.pop(key)[0] for key in list(given) if key.startswith("method.")}
    names = given.pop("method", [])
    names = list(registered_modal()) if names == [ALL] else names
    if settings and len(names) != 1:
        raise InputError(f"method.{next(iter(settings))}", next(iter(settings.values())), "with one method=")
    for name in names:
        if name not in registered_modal():
            raise InputError("method", name, f"modes= takes modal methods: {', '.join(registered_modal())}, or all")
    config = config_from({group: {} for group in GROUPS} | {key: values[0] for key, values in given.items()})
    methods = {str(name): make_modal(name, settings) for name in names}
    return ModalRequest(
        _files(config),
        replace(_options(config), sensors=True),
        methods,
        _count(config.modes),
        _band(config.band),
        config,
    )


def _count(modes: str | None) -> int | None:
    text = str(modes).strip().lower()
    if text != AUTO and not (text.isdecimal() and 1 <= int(text) <= MOST_MODES):
        raise InputError("modes", modes, f"auto, or a number from 1 to {MOST_MODES}")
    return None if text == AUTO else int(text)


def _band(band: str | None) -> tuple[float, float] | None:
    try:
        low, high = (float(part) for part in (band or "0:1").split(":"))
    except ValueError:
        low = high = 0.0
    if not 0.0 <= low < high < math.inf:
        raise InputError("band", band, "lower:upper in Hz, as 10:40")
    return (low, high) if band else None


def _joined(overrides: Overrides) -> dict[str, list[Any]]:
    return {key: [",".join(map(str, values))] if key in LISTS else list(values) for key, values in overrides.items()}


def _options(config: Config) -> ReadOptions:
    columns = pairs("columns", config.columns)
    if config.base is not None and not columns:
        raise InputError("base", config.base, "name the motion, too, as columns=t:0,a:1")
    if config.motion is not None and config.base is None and "b" not in columns:
        raise InputError("motion", config.motion, "with base=, the column of the ground's acceleration")
    if config.base is not None:
        columns |= {"b": int(config.base) if config.base.isdigit() else config.base}
    return ReadOptions(
        columns,
        pairs("units", config.units),
        config.rate,
        config.from_,
        config.to,
        config.decimate,
        config.detrend,
    )


def _files(config: Config) -> tuple[Path, ...]:
    files = tuple(Path(os.path.expanduser(part.strip())) for part in str(config.data).split(",") if part.strip())
    if not files:
        raise InputError("data", config.data, "name a file, or several with a comma between two")
    return files


def _check_single(given: Mapping[str, Sequence[Any]]) -> None:
    for key, values in given.items():
        if len(values) > 1 and key != "method":
            raise InputError(key, ",".join(map(str, values)), "one value at a time for a measured record")


def _check(given: Mapping[str, Sequence[Any]]) -> None:
    """Raise InputError for several values where one is meant, and for what belongs to a prior that is not there."""
    _check_single(given)
    if "modes" in given:
        raise InputError(
            "modes", given["modes"][0], "python -m bench data=... takes it, this verb does not; leave it out"
        )
    for key in ("band", "response", "window"):
        if key in given:
            raise InputError(key, given[key][0], "it is for modes; add modes=auto")
    nominal = [key for key in given if key.startswith("nominal.")]
    if nominal and "prior" not in given:
        raise InputError(nominal[0], given[nominal[0]][0], "a nominal value says nothing without prior=; add it")
    if given.get("disturbance", ["none"]) != ["none"]:
        raise InputError("disturbance", given["disturbance"][0], "a measured record is taken as it is; leave it out")
    for key in ("snr", "replicates", "experiment"):
        if given.get(key, [None]) != [None]:
            raise InputError(key, given[key][0], "it is of simulated data; leave it out for a measured record")


def _of_configuration(system: str) -> bool:
    """Whether a system is one of the files of the configuration, not auto or a sum of terms; raises InputError."""
    words = [word.strip().lower() for word in system.split("+")]
    if system == AUTO or len(words) > 1 or words[0] in {*TERMS, *SYSTEMS, *FIRST}:
        return False
    if system not in choices("system") and not is_user_file("system", system):
        known = ", ".join([AUTO, *dict.fromkeys([*SYSTEMS, *TERMS])])
        raise InputError("system", system, f"auto, a file of conf/system, or a sum by + of {known}")
    return True


def pairs(field: str, text: str | None) -> dict[str, Any]:
    """``t:0,x:3`` as a mapping; a whole number is one."""
    found: dict[str, Any] = {}
    for part in (text or "").split(",") if text else []:
        role, colon, value = (piece.strip() for piece in part.partition(":"))
        if not (role and colon and value):
            raise InputError(field, text, f"write role:value, as {'t:0,x:3' if field == 'columns' else 't:ms,x:mm'}")
        if role in found:
            raise InputError(field, text, f"{role} is there twice; give it once")
        found[role] = int(value) if field == "columns" and value.isdigit() else value
    return found
