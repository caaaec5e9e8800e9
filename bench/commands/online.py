"""``python -m bench -m experiment=online``: trackers on streams whose parameters change, as Table 10.

Finished runs are kept in ``store``, one file a replicate, and the same command goes on from them. ``fit=false`` makes
the table of those that are kept. ``system=<name> system.varying.<parameter>=step,ramp`` follows any system instead of
the scenarios of the track; what is made of it is written to ``out``, which is then ``outputs/online_own``.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.commands.fields import flag, listed, path_of, read_fields, whole
from bench.config.online import VARYING, online_scenario, online_track, own_scenarios, scenario_names
from bench.config.schema import MOST_WORKERS
from bench.errors import InputError
from bench.isolation.cores import usable_cores
from bench.reporting.whole_file import check_folder, write

if TYPE_CHECKING:
    from bench.online.follow import Followed
    from bench.online.paths import OnlinePath, Tracking
    from bench.online.scenario import OnlineScenario
    from bench.reporting.tables.online_table import Line

FIELDS = {
    "scenario": "", "method": "", "replicates": "", "seed": "0", "workers": "", "store": "outputs/online",
    "out": "", "dry_run": "false", "fit": "true", "system": "", "snr": "", "samples": "", "rate": "", "force": "",
}  # fmt: skip
OF_SYSTEM = ("snr", "samples", "rate", "force")
"""Fields of a scenario of one's own."""
OWN = "outputs/online_own"
"""Where what is made of a scenario of one's own goes."""
COMMAND = "python -m bench -m experiment=online"
USAGE = """usage: python -m bench -m experiment=online [field=value ...]

  scenario     {scenarios}
  method       {methods}
               or window_<batch method>
  system       a system of conf/system in place of the scenarios, with
               system.varying.<parameter>=constant, step, ramp, sinusoid or
               random_walk, several with commas, or written out:
               'system.varying.k={{kind: step, change: -0.3, at: 0.5}}'
  snr, samples, rate, force
               of that system [20 dB, 2000, 20 a cycle, multisine]; force also
               white, coloured, impulses or '{{kind: white, told: false}}'
  replicates   at most so many; without: those of the track
  seed         [0] of all random streams
  workers      [one a core] processes
  store        [outputs/online] where finished runs are kept and found again
  out          [results] where table and picture go; with system=
               [outputs/online_own]
  fit          [true] false: the table of what is kept
  dry_run      [false] say how much is to do"""


def online_usage() -> str:
    """The page of help."""
    from bench.reporting.terminal import wrapped

    text = USAGE.format(scenarios=", ".join(scenario_names()), methods=", ".join(online_track()["methods"]))
    return "\n".join(wrapped(line, " " * 15) for line in text.splitlines())


def followed_online(arguments: Sequence[str]) -> int:
    """Run the track and write its table; raises InputError."""
    from bench.online.paths import missing_paths

    varying = dict(_varying(text) for text in arguments if text.startswith(VARYING))
    fields = read_fields([text for text in arguments if not text.startswith(VARYING)], FIELDS)
    dry_run, fitting = flag("dry_run", fields["dry_run"]), flag("fit", fields["fit"])
    workers = whole("workers", fields["workers"], most=MOST_WORKERS) if fields["workers"] else usable_cores()
    every, refused = _tasks(fields, _scenarios(fields, varying))
    store, out = path_of(fields["store"]), path_of(fields["out"] or (OWN if fields["system"] else "results"))
    if not dry_run:
        check_folder(store, "store")
        check_folder(out)
    missing = missing_paths(every, store)
    print(f"bench: {sum(of.replicates for of in every)} runs, {len(missing)} to do", file=sys.stderr)
    if dry_run:
        return 0
    if missing and fitting:
        _run(missing, store, workers)
    _write(every, refused, store, out)
    return 0


def _varying(text: str) -> tuple[str, str]:
    """A parameter and its courses."""
    key, _, value = text.partition("=")
    if not value or key == VARYING:
        raise InputError("argument", text, "write system.varying.<parameter>=<kind>, e.g. system.varying.k=step")
    return key.removeprefix(VARYING), value


def _scenarios(fields: Mapping[str, str], varying: Mapping[str, str]) -> list[OnlineScenario]:
    """Those of the track that are asked for, or those of a system of one's own."""
    if fields["system"]:
        if fields["scenario"]:
            raise InputError("scenario", fields["scenario"], "left out, where system= is said")
        return own_scenarios(fields["system"], {name: fields[name] for name in OF_SYSTEM}, varying)
    for name in OF_SYSTEM:
        if fields[name]:
            raise InputError(name, fields[name], "with system=<name>; the track's scenarios have their own")
    if varying:
        raise InputError(f"{VARYING}{next(iter(varying))}", next(iter(varying.values())), "with system=<name>")
    named = listed("scenario", fields["scenario"]) if fields["scenario"] else scenario_names()
    return [online_scenario(name) for name in named]


def _tasks(fields: Mapping[str, str], scenarios: Sequence[OnlineScenario]) -> tuple[list[Tracking], list[Line]]:
    """What is to be there, and a line for each method that cannot take a scenario."""
    from bench.entrants.online import make_online
    from bench.online.paths import Tracking
    from bench.reporting.tables.online_table import Line

    content = online_track()
    methods = listed("method", fields["method"]) if fields["method"] else content["methods"]
    seed = whole("seed", fields["seed"], 0, 2**63 - 1)
    most = whole("replicates", fields["replicates"]) if fields["replicates"] else None
    settings = {name: dict(own) for name, own in content["variants"].items()}
    registered = {name: settings.get(name, {}).pop("method", name) for name in methods}
    made = {name: make_online(registered[name], settings.get(name, {})) for name in methods}
    tasks, refused = [], []
    for scenario in scenarios:
        name = scenario.label
        left_out = content["left_out"].get(name, {"methods": [], "why": ""})
        for method, identifier in made.items():
            objection = identifier.objection(scenario.layout())
            if not objection and method in left_out["methods"] and not fields["method"]:
                objection = left_out["why"]
            if objection:
                refused.append(Line(name, method, _title(method, registered[method]), message=objection))
                continue
            n = content["replicates_by_method"].get(method, content["replicates"])
            n = n if most is None else min(n, most)
            tasks.append(Tracking(scenario, registered[method], settings.get(method, {}), n, seed, method))
    return tasks, refused


def _title(label: str, method: str) -> str:
    """What a method is called; a variant by its settings' name."""
    from bench.entrants.online import online_card

    title = online_card(method).title
    return title if label == method else f"{title} ({label.removeprefix(method).strip('_')})"


def _run(missing: Sequence[OnlinePath], store: Path, workers: int) -> None:
    from bench.run.pool import Limits, run_tasks
    from bench.run.progress import progress_bar

    with progress_bar() as on_look:
        errors = run_tasks(missing, store, Limits(workers), ("run", ""), on_look)
    for path in missing:
        if error := errors.get(path.key):
            print(f"{path.of.scenario.label}, {path.of.label}, replicate {path.replicate}: {error}", file=sys.stderr)


def _write(tasks: Sequence[Tracking], refused: Sequence[Line], store: Path, out: Path) -> None:
    from bench.reporting.figures.online import draw_online
    from bench.reporting.tables.online_table import table

    scenarios = {task.scenario.label: task.scenario for task in tasks}
    lines, shown = [], []
    for scenario in scenarios.values():
        own = [task for task in tasks if task.scenario is scenario or task.scenario == scenario]
        found = _scored(scenario, own, store)
        lines += [*found[0], *(line for line in refused if line.scenario == scenario.label)]
        if found[1] is not None:
            shown.append(found[1])
    described = {name: scenario.describe() for name, scenario in scenarios.items()}
    for name, text in table(lines, described, COMMAND).items():
        write(out / name, text, out)
        print(out / name)
    try:
        for place in draw_online(shown, out / "figures"):
            print(place)
    except ImportError as error:
        print(f"bench: no picture, since {error.name} is missing", file=sys.stderr)


def _scored(scenario: OnlineScenario, tasks: Sequence[Tracking], store: Path) -> tuple[list[Line], Any]:
    """A line a method, and what the picture of the first replicate shows."""
    from bench.online.bound import bound_variances
    from bench.online.paths import read_paths
    from bench.online.score import score, score_bound, scored
    from bench.reporting.figures.online import Shown
    from bench.reporting.tables.online_table import BOUND, Line

    count = max(task.replicates for task in tasks)
    streams = [scenario.stream(tasks[0].seed, i) for i in range(count)]
    bounds = [bound_variances(scenario, stream) for stream in streams]
    quantities = [q.name for q in streams[0].layout.system.groups]
    by_name = {q.name: q for q in streams[0].layout.quantities}
    least = {
        name: score_bound(scenario, streams, [bound[name] for bound in bounds], by_name[name]) for name in quantities
    }
    lines, drawn = [Line(scenario.label, BOUND, BOUND, least, count, count)], {}
    for task in tasks:
        kept = read_paths(store, task)
        title = _title(task.label, task.method)
        good = {i: path for i, path in kept.items() if np.isfinite(path.means).all(axis=1).any()}
        if not good:
            said = "no run gave an estimate" if kept else "not run yet"
            lines.append(Line(scenario.label, task.label, title, replicates=task.replicates, message=said))
            continue
        scores = {
            name: score(scenario, [scored(streams[i], path, bounds[i], name) for i, path in good.items()])
            for name in quantities
        }
        micros = _micros(list(good.values()))
        size = max(path.held_bytes for path in good.values())
        lines.append(
            Line(scenario.label, task.label, title, scores, len(good), task.replicates, micros, size)
        )  # fmt: skip
        if 0 in good:
            drawn[title] = (good[0], scores[quantities[0]].excess)
    shown = Shown(scenario.label, streams[0], bounds[0], quantities[0], drawn) if drawn else None
    return lines, shown


def _micros(paths: Sequence[Followed]) -> tuple[float, float, float]:
    """Median, 99 % and largest wall time of a sample behind the first estimate."""
    from bench.online.follow import begun

    each = np.concatenate([path.micros[min(begun(path) + 1, len(path.micros) - 1) :] for path in paths])
    return float(np.median(each)), float(np.quantile(each, 0.99)), float(each.max())
