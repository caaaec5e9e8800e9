"""``python -m bench -m experiment=online``: trackers on streams whose parameters change, as Table 10.

Finished runs are kept in ``store``, one file a replicate, and the same command goes on from them. ``fit=false`` makes
the table of those that are kept.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.commands.guard import read_fields, whole

if TYPE_CHECKING:
    from bench.online.follow import Followed
    from bench.online.paths import Paths, Task
    from bench.online.scenario import OnlineScenario
    from bench.reporting.tables.online_table import Line

FIELDS = {
    "scenario": "", "method": "", "replicates": "", "seed": "0", "workers": "", "store": "outputs/online",
    "out": "results", "dry_run": "false", "fit": "true",
}  # fmt: skip
COMMAND = "python -m bench -m experiment=online"


def followed_online(arguments: Sequence[str]) -> int:
    """Run the track and write its table; raises InputError."""
    from bench.online.paths import Paths, missing

    fields = read_fields(arguments, FIELDS)
    every, refused = _tasks(fields)
    paths = Paths(Path(fields["store"]))
    left = sum(len(missing(task, paths)) for task in every)
    print(f"bench: {sum(task.replicates for task in every)} runs, {left} to do", file=sys.stderr)
    if fields["dry_run"] == "true":
        return 0
    if left and fields["fit"] == "true":
        _run(every, paths, left, whole("workers", fields["workers"]) if fields["workers"] else os.cpu_count() or 1)
    _write(every, refused, paths, Path(fields["out"]))
    return 0


def _listed(text: str) -> list[str]:
    return [part.strip() for part in text.split(",") if part.strip()]


def _tasks(fields: Mapping[str, str]) -> tuple[list[Task], list[Line]]:
    """What is to be there, and a line for each method that cannot take a scenario."""
    from bench.config.online import online_scenario, online_track, scenario_names
    from bench.entrants.online import make_online
    from bench.online.paths import Task
    from bench.reporting.tables.online_table import Line

    content = online_track()
    methods = _listed(fields["method"]) or content["methods"]
    settings = {name: dict(own) for name, own in content["variants"].items()}
    registered = {name: settings.get(name, {}).pop("method", name) for name in methods}
    made = {name: make_online(registered[name], settings.get(name, {})) for name in methods}
    tasks, refused = [], []
    for name in _listed(fields["scenario"]) or scenario_names():
        scenario = online_scenario(name)
        left_out = content["left_out"].get(name, {"methods": [], "why": ""})
        for method, identifier in made.items():
            objection = identifier.objection(scenario.layout())
            if not objection and method in left_out["methods"] and not _listed(fields["method"]):
                objection = left_out["why"]
            if objection:
                refused.append(Line(name, method, _title(method, registered[method]), message=objection))
                continue
            n = content["replicates_by_method"].get(method, content["replicates"])
            if fields["replicates"]:
                n = min(n, whole("replicates", fields["replicates"]))
            seed = whole("seed", fields["seed"], least=0)
            tasks.append(Task(scenario, registered[method], settings.get(method, {}), n, seed, method))
    return tasks, refused


def _title(label: str, method: str) -> str:
    """What a method is called; a variant by its settings' name."""
    from bench.entrants.online import online_card

    title = online_card(method).title
    return title if label == method else f"{title} ({label.removeprefix(method).strip('_')})"


def _run(tasks: Sequence[Task], paths: Paths, left: int, workers: int) -> None:
    from tqdm import tqdm

    from bench.online.paths import run

    with tqdm(total=left, unit="run", file=sys.stderr) as bar:
        for task, replicate, error in run(tasks, paths, workers):
            bar.update()
            if error:
                bar.write(f"{task.scenario.label}, {task.label}, replicate {replicate}: {error}", file=sys.stderr)


def _write(tasks: Sequence[Task], refused: Sequence[Line], paths: Paths, out: Path) -> None:
    from bench.reporting.figures.online import draw_online
    from bench.reporting.tables.online_table import table

    scenarios = {task.scenario.label: task.scenario for task in tasks}
    lines, shown = [], []
    for scenario in scenarios.values():
        own = [task for task in tasks if task.scenario is scenario or task.scenario == scenario]
        found = _scored(scenario, own, paths)
        lines += [*found[0], *(line for line in refused if line.scenario == scenario.label)]
        if found[1] is not None:
            shown.append(found[1])
    out.mkdir(parents=True, exist_ok=True)
    described = {name: scenario.describe() for name, scenario in scenarios.items()}
    for name, text in table(lines, described, COMMAND).items():
        (out / name).write_text(text, encoding="utf-8")
        print(out / name)
    try:
        for place in draw_online(shown, out / "figures"):
            print(place)
    except ImportError as error:
        print(f"bench: no picture, since {error.name} is missing", file=sys.stderr)


def _scored(scenario: OnlineScenario, tasks: Sequence[Task], paths: Paths) -> tuple[list[Line], Any]:
    """A line a method, and what the picture of the first replicate shows."""
    from bench.online.bound import bound_variances
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
        kept = {i: path for i in range(task.replicates) if (path := paths.get(task.key(i))) is not None}
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
