"""Requests for the identification of measured records: files, reading options, system and methods."""

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
"""Fields whose value is a list separated by commas."""
AUTO = "auto"
ALL = "all"
VISCOUS = "sdof"


@dataclass(frozen=True)
class Request:
    """Request for parametric identification.

    Attributes:
        files: Files of records of one test.
        options: Reading options.
        system: System as the user wrote it.
        jobs: One job per method.
    """

    files: tuple[Path, ...]
    options: ReadOptions
    system: str
    jobs: tuple[Job, ...]

    @property
    def job(self) -> Job:
        """The first job; all jobs share everything but the method."""
        return self.jobs[0]


@dataclass(frozen=True)
class ModalRequest:
    """Request for modal identification.

    Attributes:
        files: Files of records of one test.
        options: Reading options.
        methods: Modal methods by name; if empty, the kind of data determines the method.
        count: Number of modes; None to choose it by the data.
        band: Lower and upper frequency (Hz).
        config: Configuration of the command.
    """

    files: tuple[Path, ...]
    options: ReadOptions
    methods: Mapping[str, ModalIdentifier]
    count: int | None
    band: tuple[float, float] | None
    config: Config


def request_of(overrides: Overrides) -> Request:
    """Return the request of a command's overrides; no file is read.

    Raises:
        InputError: A field is invalid, or does not apply to measured records.
    """
    given = _joined(overrides)
    _check(given)
    system = str(given.pop("system", [VISCOUS])[0])
    if _is_configured(system):
        given["system"] = [system]
    elif any(key.startswith("system.") for key in given):
        raise InputError("system", system, "sums of terms have no further fields; omit system.<field>")
    if given.get("method") == [ALL]:
        given["method"] = [name for name in method_names() if name not in REFERENCES]
    if "method" not in given and "experiment" not in given:
        given["method"] = [default_method()]
    jobs = sweep(given, measured=True)
    config = jobs[0].config
    options, files = _options(config), _files(config)
    if options.decimate > 1 and config.start is not None:
        raise InputError("start", config.start, "decimate= drops the first samples; omit start= or decimate=")
    spec = jobs[0].prior_spec() if "prior" in given else None
    if spec is not None and (spec.wrong or spec.draws != "nominal"):
        field, value = ("prior.draws", spec.draws) if spec.draws != "nominal" else ("prior", spec.name)
        raise InputError(field, value, "for simulated data only; set your values by nominal.<p>=")
    return Request(files, options, system, tuple(jobs))


def modal_request_of(overrides: Overrides) -> ModalRequest:
    """Return the modal request of a command's overrides with ``modes=``; no file is read.

    Raises:
        InputError: A field is invalid, or does not apply to modes.
    """
    given = _joined(overrides)
    _check_single(given)
    for key in (key for key in given if key.partition(".")[0] not in MODAL and given[key] != [None]):
        raise InputError(key, given[key][0], "cannot be combined with modes=; omit one of the two")
    settings = {key.removeprefix("method."): given.pop(key)[0] for key in list(given) if key.startswith("method.")}
    names = given.pop("method", [])
    names = list(registered_modal()) if names == [ALL] else names
    if settings and len(names) != 1:
        raise InputError(f"method.{next(iter(settings))}", next(iter(settings.values())), "it needs a single method=")
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
        raise InputError("modes", modes, f"use auto or a number from 1 to {MOST_MODES}")
    return None if text == AUTO else int(text)


def _band(band: str | None) -> tuple[float, float] | None:
    try:
        low, high = (float(part) for part in (band or "0:1").split(":"))
    except ValueError:
        low = high = 0.0
    if not 0.0 <= low < high < math.inf:
        raise InputError("band", band, "use lower:upper in Hz, such as 10:40")
    return (low, high) if band else None


def _joined(overrides: Overrides) -> dict[str, list[Any]]:
    return {key: [",".join(map(str, values))] if key in LISTS else list(values) for key, values in overrides.items()}


def _options(config: Config) -> ReadOptions:
    columns = pairs("columns", config.columns)
    if config.base is not None and not columns:
        raise InputError("base", config.base, "name the columns of the motion as well, such as columns=t:0,a:1")
    if config.motion is not None and config.base is None and "b" not in columns:
        raise InputError("motion", config.motion, "it needs base=, the column with the acceleration of the ground")
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
        raise InputError("data", config.data, "name a file, or several separated by commas")
    return files


def _check_single(given: Mapping[str, Sequence[Any]]) -> None:
    for key, values in given.items():
        if len(values) > 1 and key != "method":
            raise InputError(key, ",".join(map(str, values)), "use a single value for measured records")


def _check(given: Mapping[str, Sequence[Any]]) -> None:
    """Raise InputError for several values of a field, and for fields that do not apply to measured records."""
    _check_single(given)
    if "modes" in given:
        raise InputError("modes", given["modes"][0], "not supported by this command; use python -m bench data=...")
    for key in ("band", "response", "window"):
        if key in given:
            raise InputError(key, given[key][0], "it applies to modes only; add modes=auto")
    nominal = [key for key in given if key.startswith("nominal.")]
    if nominal and "prior" not in given:
        raise InputError(nominal[0], given[nominal[0]][0], "nominal values need prior=; add it")
    if given.get("disturbance", ["none"]) != ["none"]:
        raise InputError("disturbance", given["disturbance"][0], "for simulated data only; omit it")
    for key in ("snr", "replicates", "experiment"):
        if given.get(key, [None]) != [None]:
            raise InputError(key, given[key][0], "for simulated data only; omit it")


def _is_configured(system: str) -> bool:
    """Return whether a system is a file of the configuration rather than auto or a sum; raises InputError."""
    words = [word.strip().lower() for word in system.split("+")]
    if system == AUTO or len(words) > 1 or words[0] in {*TERMS, *SYSTEMS, *FIRST}:
        return False
    if system not in choices("system") and not is_user_file("system", system):
        known = ", ".join([AUTO, *dict.fromkeys([*SYSTEMS, *TERMS])])
        raise InputError("system", system, f"use auto, a file of conf/system, or a sum by + of {known}")
    return True


def pairs(field: str, text: str | None) -> dict[str, Any]:
    """Parse a list such as ``t:0,x:3``; the values of ``columns`` are numbers or headers. Raises InputError."""
    values: dict[str, Any] = {}
    for part in (text or "").split(",") if text else []:
        role, colon, value = (piece.strip() for piece in part.partition(":"))
        if not (role and colon and value):
            raise InputError(field, text, f"use role:value, such as {'t:0,x:3' if field == 'columns' else 't:ms,x:mm'}")
        if role in values:
            raise InputError(field, text, f"{role} occurs twice; use it once")
        values[role] = int(value) if field == "columns" and value.isdigit() else value
    return values
