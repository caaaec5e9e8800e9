"""``python -m bench.track``: the live twin. Reads samples as lines, writes what is believed after each as JSON.

A line holds the time (s), a value a sensor, and a force (N) a forced DOF, with commas, semicolons, tabs or blanks
between them; an empty field or nan is a missing value. It ends with the stream; Ctrl-C ends it too, with its state kept
where ``state`` says.
"""

from __future__ import annotations

import itertools
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from bench.commands.fields import file_of, flag, listed, number, one_of, path_of, read_fields, whole
from bench.commands.guard import command
from bench.errors import InputError
from bench.isolation.processes import compiled_single_threaded
from bench.reporting.whole_file import check_file, is_special

if TYPE_CHECKING:
    from bench.contract.online import Layout, OnlineIdentifier, Tracker
    from bench.twin.page import Page
    from bench.twin.pressure import Intake

FIELDS = {
    "system": "sdof", "method": "", "sensors": "", "forced": "", "ambient": "", "limits": "", "rate": "",
    "from": "-", "follow": "false", "out": "-", "view": "false", "page": "false", "port": "0", "policy": "lag",
    "queue": "2000", "state": "", "save_every": "1000", "resume": "false", "alarm": "",
}  # fmt: skip
USAGE = """usage: python -m bench.track system=sdof method=<name> [field=value ...] < stream

  system     [sdof] a system of conf/system, for its equations alone
  method     [{first}] {methods}
             or window_<batch method> (length=150 every=10); method.<setting>=
  sensors    [displacement of every DOF] displacement:0,acceleration:1
  forced     DOFs whose force stands in the lines, e.g. 0; without: none
  ambient    DOFs under a force that nobody measures
  limits     lo:hi, the range of the sensors
  rate       samples a second; without: from the first lines
  from       [-] a file or pipe; follow=true waits for more
  out        [-] where the JSON lines go: a file, - or none
  view       [false] show the twin in the terminal (on the error stream)
  page       [false] serve a page on this machine alone; port [0: any free one]
  policy     [lag] or decimate, where samples come faster than the method
  queue      [2000] samples that may wait
  state      a file to keep the state in, every save_every [1000] samples and at
             the end; resume=true goes on from it, and counts nothing twice
  alarm      threshold of the method's alarm; without: none rings"""
INTERRUPTED = "interrupted; the state is kept where state= says"
FIRST_LINES, LEAST_RATE = 20, 1e-9


def main(argv: Sequence[str] | None = None) -> int:
    """``python -m bench.track [field=value ...]``; exit status 2 for bad input, 130 when interrupted."""
    return command("bench.track", _usage(), argv, tracked, INTERRUPTED)


def _usage() -> str:
    from bench.entrants.online import first_online, registered_online

    return f"{USAGE.format(first=first_online(), methods=', '.join(registered_online()))}\n\n{__doc__}"


def tracked(arguments: Sequence[str]) -> int:
    """Run the twin until its stream ends."""
    compiled_single_threaded()
    fields, settings = _read(arguments)
    method = _method(fields["method"], settings)
    shape = _shape(fields)
    objection = method.objection(_layout(shape, 1.0))
    if objection:
        raise InputError("method", fields["method"], objection)
    for name in ("out", "state"):
        _check_writable(name, fields[name])
    if fields["rate"]:
        _rate(fields["rate"])
    content = _state(fields)
    intake = _intake(fields, shape)
    held: list[Any] = []
    interval = content["interval"] if content else _interval(fields["rate"], intake, held)
    layout = _layout(shape, interval)
    from bench.twin.state import resumed

    tracker = resumed(path_of(fields["state"]), content, method, layout) if content else method.start(layout)
    tracker.prepare()
    page = _page(fields, layout)
    try:
        _follow(fields, method, tracker, intake, held, page)
        if not tracker.samples and intake.unreadable:
            raise InputError("stream", f"{intake.unreadable} line(s)", f"lines that read {intake.form.columns}")
    finally:
        if page is not None:
            page.close()
    return 0


def _check_writable(field: str, text: str) -> None:
    """Raise InputError before any sample is read where a file cannot be written.

    Lines may go to a pipe or a device, which is not tried.
    """
    path = path_of(text)
    if text not in ("", "-", "none") and not (field == "out" and is_special(path)):
        check_file(path, field)


def _read(arguments: Sequence[str]) -> tuple[dict[str, str], dict[str, Any]]:
    """Fields, and the settings of the method."""
    from bench.config.suggest import did_you_mean

    settings, rest = {}, []
    for argument in arguments:
        key, _, value = argument.partition("=")
        if key.startswith("method.") and value:
            settings[key.removeprefix("method.")] = _value(key, value)
        else:
            rest.append(argument)
            if key not in FIELDS:
                raise InputError("argument", argument, f"{did_you_mean(key, list(FIELDS))}see --help")
    fields = read_fields(rest, FIELDS)
    for name in ("follow", "view", "page", "resume"):
        flag(name, fields[name])
    one_of("policy", fields["policy"], ("lag", "decimate"))
    whole("save_every", fields["save_every"])
    whole("port", fields["port"], 0, 65535)
    _threshold(fields["alarm"])
    return fields, settings


def _value(field: str, text: str) -> Any:
    import yaml

    try:
        return yaml.safe_load(text)
    except (yaml.YAMLError, RecursionError):
        raise InputError(field, text, "a number, a word, or a list as [1, 2]") from None


def _method(name: str, settings: Mapping[str, Any]) -> OnlineIdentifier:
    from bench.config.suggest import did_you_mean
    from bench.entrants.online import first_online, make_online, online_names

    name = name or first_online()
    if name not in online_names():
        near = did_you_mean(name, online_names())
        raise InputError("method", name, f"{near}online methods: {', '.join(online_names())}")
    return make_online(name, settings)


def _shape(fields: Mapping[str, str]) -> dict[str, Any]:
    """The layout but for its interval."""
    from bench.config.choices import check_choice
    from bench.config.online import system_content
    from bench.contract.online import Sensor
    from bench.systems import MEASURED, make_system

    check_choice("system", fields["system"])
    stated = system_content(fields["system"])
    system = make_system(stated["kind"], stated["options"])  # equations alone, no true value
    limits = _limits(fields["limits"])
    named = fields["sensors"] or ",".join(f"displacement:{dof}" for dof in range(system.n_dof))
    sensors = []
    for text in listed("sensors", named):
        kind, _, dof = text.partition(":")
        if kind not in MEASURED or (dof or "0") not in map(str, range(system.n_dof)):
            wanted = f"<{', '.join(MEASURED)}>:<DOF>, of DOFs 0 to {system.n_dof - 1}, several with commas"
            raise InputError("sensors", text, wanted)
        sensors.append(Sensor(kind, int(dof or "0"), limits))  # type: ignore[arg-type]
    dofs = {name: _dofs(name, fields[name], system.n_dof) for name in ("forced", "ambient")}
    return {"system": system, "sensors": tuple(sensors), **dofs}


def _dofs(field: str, text: str, n: int) -> tuple[int, ...]:
    """Different DOFs of a system that has ``n``."""
    found = tuple(whole(field, part, 0, n - 1) for part in listed(field, text)) if text else ()
    if len(set(found)) < len(found):
        raise InputError(field, text, "every DOF once")
    return found


def _limits(text: str) -> tuple[float, float] | None:
    if not text:
        return None
    try:
        low, high = (float(part) for part in text.split(":"))
    except ValueError:
        low, high = math.nan, math.nan
    if not low < high:
        raise InputError("limits", text, "lo:hi, the lower first, e.g. -0.1:0.1")
    return low, high


def _layout(shape: Mapping[str, Any], interval: float) -> Layout:
    from bench.contract.online import Layout

    return Layout(shape["system"], shape["sensors"], interval, shape["forced"], shape["ambient"])


def _intake(fields: Mapping[str, str], shape: Mapping[str, Any]) -> Intake:
    from bench.twin.lines import Form, lines, opened
    from bench.twin.pressure import Intake

    follow = fields["follow"] == "true"
    if follow and fields["from"] == "-":
        raise InputError("follow", "true", "with from=<file>; standard input is waited on anyway")
    form = Form(len(shape["sensors"]), len(shape["forced"]))
    source = lines(opened(fields["from"]), fields["from"], follow)
    return Intake(source, form, fields["policy"], whole("queue", fields["queue"], least=10))  # type: ignore[arg-type]


def _state(fields: Mapping[str, str]) -> dict[str, Any] | None:
    from bench.twin.state import read

    if fields["resume"] == "true" and not fields["state"]:
        raise InputError("resume", "true", "with state=<file>")
    if fields["resume"] != "true":
        return None
    wanted = "a state file of this command; leave resume out to begin"
    return read(file_of("state", fields["state"], wanted))


def _interval(rate: str, intake: Intake, held: list[Any]) -> float:
    """Of the samples (s): as told, or the median of the first; what was read for it is held."""
    if rate:
        return 1.0 / _rate(rate)
    while len(held) < FIRST_LINES:
        sample = intake.get()
        held.append(sample)
        if sample is None:
            break
    times = sorted({sample.time for sample in held if sample is not None})
    steps = sorted(b - a for a, b in itertools.pairwise(times))
    if not steps:
        wanted = f"lines that read {intake.form.columns}; or say rate="
        raise InputError("stream", f"{len(times)} sample(s)", wanted)
    return float(steps[len(steps) // 2])


def _rate(text: str) -> float:
    return number("rate", text, LEAST_RATE, 1.0 / LEAST_RATE, "samples a second, a positive number")


def _page(fields: Mapping[str, str], layout: Layout) -> Page | None:
    if fields["page"] != "true":
        return None
    try:
        from bench.twin.page import Page
    except ImportError as error:
        raise InputError("page", "true", f"needs {error.name}: pip install 'vibration-bench[twin]'") from None
    page = Page(layout, whole("port", fields["port"], least=0, most=65535))
    print(f"bench.track: {page.url}", file=sys.stderr, flush=True)
    return page


def _follow(
    fields: Mapping[str, str], method: OnlineIdentifier, tracker: Tracker, intake: Intake, held: list[Any],
    page: Page | None,
) -> None:  # fmt: skip
    """Take samples until the stream ends; keep the state on the way, at the end, and when interrupted."""
    from bench.twin.report import content, line
    from bench.twin.state import save
    from bench.twin.terminal import View

    alarm_at = _threshold(fields["alarm"])
    every, place = whole("save_every", fields["save_every"]), fields["state"]
    view = View(tracker.layout) if fields["view"] == "true" else None
    last, again = tracker.last, 0
    with _Output(fields["out"], tracker.samples if fields["resume"] == "true" else None) as out:
        try:
            while (sample := held.pop(0) if held else intake.get()) is not None:
                if last is not None and sample.time <= last:
                    again += 1
                    continue
                found = content(tracker.samples + 1, sample, tracker.update(sample), tracker.layout, alarm_at)
                found |= {"waiting": intake.waiting, "decimated": intake.decimated, "unreadable": intake.unreadable}
                out.write(line(found))
                for shown in (view, page):
                    if shown is not None:
                        shown.add(found)
                if place and tracker.samples % every == 0:
                    save(path_of(place), method, tracker)
        finally:
            if place:
                save(path_of(place), method, tracker)
            if view is not None:
                view.close()
            if again:
                print(f"bench.track: {again} sample(s) had been seen before; left out", file=sys.stderr)


def _threshold(text: str) -> float | None:
    return number("alarm", text, wanted="a number, compared with the method's alarm") if text else None


class _Output:
    """Where the lines go: a file, the output, or nowhere. Further than a state, a file's lines are written anew."""

    def __init__(self, place: str, seen: int | None) -> None:
        self.file: TextIO | None = None
        self.own = place not in ("-", "none")
        if place == "-":
            self.file = sys.stdout
        elif self.own:
            try:
                path = path_of(place)
                before = [] if seen is None else _until(path, seen)
                self.file = path.open("w", encoding="utf-8")
                self.file.writelines(before)
            except OSError as error:
                raise InputError("out", place, f"cannot be written: {error.strerror}") from None

    def write(self, text: str) -> None:
        """A line, at once."""
        if self.file is not None:
            self.file.write(text + "\n")
            self.file.flush()

    def __enter__(self) -> _Output:
        return self

    def __exit__(self, *_: object) -> None:
        if self.own and self.file is not None:
            self.file.close()


def _until(place: Path, seen: int) -> list[str]:
    """The lines of an earlier run of samples that the state has seen."""
    import json

    kept = []
    for text in place.read_text(encoding="utf-8").splitlines(keepends=True) if place.is_file() else []:
        try:
            if json.loads(text)["sample"] <= seen:
                kept.append(text)
        except (ValueError, KeyError):
            continue  # half of a line, where a run was killed
    return kept


if __name__ == "__main__":
    sys.exit(main())
