"""The verb ``track``: track parameters in a stream of samples."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from bench.commands.declaration import OneOf, Others, Parsed, Within, file, settings_of
from bench.commands.log import LOG
from bench.errors import InputError
from bench.scenario.declaration import value_of

if TYPE_CHECKING:
    from bench.contract.online import Layout, Sensor
    from bench.systems import System
    from bench.twin.session import Display


def range_of(text: str) -> tuple[float, float]:
    """Read a range, lo:hi."""
    try:
        low, high = (float(part) for part in text.split(":"))
    except ValueError:
        low, high = math.nan, math.nan
    if not low < high:
        raise ValueError("lo:hi, the lower first, e.g. -0.1:0.1")
    return low, high


def systems() -> Sequence[str]:
    """Return the systems of the configuration."""
    from bench.config.choices import choices

    return choices("system")


def trackers() -> Sequence[str]:
    """Return the online methods, and every batch method in windows."""
    from bench.entrants.online import online_names

    return online_names()


def track(
    settings: Annotated[Sequence[str], Others(("method",)), "method.<setting>="],
    system: Annotated[str, OneOf(systems), "system of conf/system, for its equations alone"] = "sdof",
    method: Annotated[str | None, OneOf(trackers), "online method, or window_<batch method> (method.length=150 "
                      "method.every=10) [ekf]"] = None,
    sensors: Annotated[tuple[str, ...], "displacement:0,acceleration:1 [displacement of every DOF]"] = (),
    forced: Annotated[tuple[str, ...], "DOFs whose force is a column, e.g. 0 [none]"] = (),
    ambient: Annotated[tuple[str, ...], "DOFs under an unmeasured force [none]"] = (),
    limits: Annotated[tuple[float, float] | None, Parsed(range_of), "lo:hi, measuring range of the sensors"] = None,
    rate: Annotated[float | None, Within(ge=1e-9, le=1e9), "sampling rate (1/s) [of the first lines]"] = None,
    columns: Annotated[str | None, "which column is what: t:0,x:3 [by the header, else in order]"] = None,
    units: Annotated[str | None, "t:ms,x:mm [of the header, else SI]"] = None,
    decimate: Annotated[int | None, Within(ge=1, le=100_000), "keep every Nth sample after a low-pass filter "
                        "[1, or what leaves 10 samples per cycle]"] = None,
    band: Annotated[tuple[float, float] | None, Parsed(range_of), "lo:hi (Hz), band-pass filter"] = None,
    from_: Annotated[str, "file or named pipe; - is standard input"] = "-",
    follow: Annotated[bool, "wait for more lines at the end of a file"] = False,
    out: Annotated[str, "destination of the JSON lines: a file, - or none"] = "-",
    view: Annotated[bool, "show the estimates in the terminal, on the error stream"] = False,
    page: Annotated[bool, "serve a page, to this machine only"] = False,
    port: Annotated[int, Within(ge=0, le=65535), "port of the page; 0: any free one"] = 0,
    policy: Annotated[Literal["lag", "decimate"], "if samples arrive faster than they are processed"] = "lag",
    queue: Annotated[int, Within(ge=10), "number of samples that may be queued"] = 2000,
    state: Annotated[Path | None, "file of the tracker's state, for resume=true"] = None,
    save_every: Annotated[int, Within(ge=1), "samples between two writes of the state"] = 1000,
    resume: Annotated[bool, "continue from the saved state; no sample is used twice"] = False,
    alarm: Annotated[float | None, "threshold of the method's alarm [none]"] = None,
) -> int:  # fmt: skip
    """Track the parameters of a system in a stream of samples.

    Reads one sample per line and writes the estimates after each sample as a line of JSON. A line holds the time, one
    value per sensor and one force per forced DOF, separated by commas, semicolons, tabs or blanks. A header names
    columns and units as in files; without one the columns have this order and SI units. An empty field or nan is a
    missing value. Tracking ends with the stream or with Ctrl-C; state= names the file of the state.
    """
    from itertools import chain, islice

    from bench.contract.online import Layout
    from bench.entrants.online import first_online, make_online
    from bench.isolation.machine import compiled_single_threaded
    from bench.records.reading.table import ReadOptions
    from bench.records.request import pairs
    from bench.reporting.whole_file import check_file, is_special
    from bench.twin.filtering import Filter, look, survey
    from bench.twin.lines import ENOUGH, FEW, form_of, head_of, lines_of, opened
    from bench.twin.pressure import Intake
    from bench.twin.session import Output, Session, interval_of
    from bench.twin.state import read
    from bench.twin.state import resume as resume_tracker

    compiled_single_threaded()
    name = method or first_online()
    identifier = make_online(name, settings_of(settings).get("method", {}))
    equations = _equations(system)
    options = ReadOptions(pairs("columns", columns), pairs("units", units))
    measured, n = _sensors(sensors, equations, limits, options.columns), equations.n_dof
    driven = _dofs("forced", forced, n), _dofs("ambient", ambient, n)

    def layout(interval: float) -> Layout:
        return Layout(equations, measured, interval, *driven)

    objection = identifier.objection(layout(1.0))
    if objection:
        raise InputError("method", name, objection)
    path = Path(os.path.expanduser(out))
    _check_apart(from_, path if out not in ("-", "none") else None, state)
    if out not in ("-", "none") and not is_special(path):  # not for a pipe or a device
        check_file(path)
    if state is not None:
        check_file(state, "state")
    if follow and from_ == "-":
        raise InputError("follow", "true", "with from=<file>; standard input is waited on anyway")
    if resume and state is None:
        raise InputError("resume", "true", "with state=<file>")
    kept = read(file("state", state, "a state file of this command")) if resume and state else {}
    stream = opened(from_)
    source = lines_of(stream, follow)
    above, lines = head_of(source, FEW if kept or rate else ENOUGH)
    roles = ["t", *(f"{s.measures[0] if s.measures != 'displacement' else 'x'}{s.dof + 1}" for s in measured)]
    form = form_of(above, lines, [*roles, *(f"f{dof + 1}" for dof in driven[0])], options)
    interval = kept["interval"] if kept else 1.0 / rate if rate else interval_of(map(form.sample, lines), str(form))
    if not kept:
        lines += islice(source, max(look(interval) - len(lines), 0))
    first = [s for line in lines if (s := form.sample(line))]
    thinned, text = survey(first, interval, band, decimate or kept.get("decimate"))
    LOG.info(text)
    filtered = Filter(interval, thinned, band, measured)
    if filtered.sections is not None:
        LOG.info(f"the estimates lag by {filtered.delay:.3g} s, the delay of the filter")
    interval *= thinned
    tracker = identifier.start(layout(interval))
    if state is not None and kept:
        tracker = resume_tracker(state, kept, identifier, layout(interval), filtered)
    LOG.info("preparing %s, which may take some seconds", name)
    tracker.prepare()
    displays = _displays(tracker.layout, view, page, port)
    intake = Intake(chain(lines, source), form, policy, queue)
    session = Session(identifier, tracker, intake, filtered, alarm, state, save_every, displays)
    with Output(out, path, tracker.samples if resume else None) as output:
        session.follow(output)
    if from_ != "-":
        stream.close()
    return 0


def _check_apart(source: str, out: Path | None, state: Path | None) -> None:
    """Raise InputError if two of the stream, the output and the state are the same file."""
    places = [("from", None if source == "-" else Path(os.path.expanduser(source))), ("out", out), ("state", state)]
    given = [(field, place) for field, place in places if place is not None and str(place) != os.devnull]
    for i, (field, place) in enumerate(given):
        for other, earlier in given[:i]:
            same = place.exists() and earlier.exists() and place.samefile(earlier)
            if same or os.path.realpath(place) == os.path.realpath(earlier):
                raise InputError(
                    field, place, f"{other}= names the same file, which would be overwritten; name another"
                )
    if source == "-" and out is not None and out.exists() and os.path.samestat(os.fstat(0), out.stat()):
        raise InputError("out", out, "standard input reads this file, which would be overwritten; name another")


def _equations(name: str) -> System:
    """Return the equations of a system, without its true values."""
    from bench.config.composition import content_of
    from bench.systems import make_system

    content = content_of("system", name)
    return make_system(content["kind"], content.get("options", {}))


def _sensors(
    names: Sequence[str], system: System, limits: tuple[float, float] | None, columns: Iterable[str]
) -> tuple[Sensor, ...]:
    """Return the sensors of a stream, by default those of the named columns; raises InputError."""
    from bench.contract.online import Sensor
    from bench.records.reading.table import slot
    from bench.records.reading.units import MEASURES
    from bench.systems import MEASURED

    named = [f"{MEASURES[letter]}:{dof}" for letter, dof in map(slot, columns) if letter not in "tf"]
    sensors = []
    for text in names or named or [f"displacement:{dof}" for dof in range(system.n_dof)]:
        kind, _, dof = text.partition(":")
        if kind not in MEASURED or (dof or "0") not in map(str, range(system.n_dof)):
            wanted = f"<{', '.join(MEASURED)}>:<DOF>, of DOFs 0 to {system.n_dof - 1}, several with commas"
            raise InputError("sensors", text, wanted)
        sensors.append(Sensor(kind, int(dof or "0"), limits))  # type: ignore[arg-type]
    return tuple(sensors)


def _dofs(field: str, names: Sequence[str], n: int) -> tuple[int, ...]:
    return tuple(value_of(Annotated[int, Within(ge=0, lt=n)], name, field) for name in names)


def _displays(layout: Layout, view: bool, page: bool, port: int) -> list[Display]:
    """Return the terminal and page displays; raises InputError if the page cannot be served."""
    displays: list[Display] = []
    if view:
        from bench.twin.terminal import View

        displays.append(View(layout))
    if page:
        from bench.twin.page import PageServer

        served = PageServer(layout, port)
        LOG.info("page: %s", served.url)
        displays.append(served)
    return displays
