"""The online track: ``python -m bench -m experiment=online``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from bench.commands.declaration import OneOf, Others, Parsed, Within
from bench.commands.log import LOG
from bench.commands.work import DryRun, Fit, Work, Workers
from bench.config.online import VARYING, online_scenario, online_track, scenario_names, scenarios_from_system
from bench.errors import InputError
from bench.isolation.machine import usable_cores
from bench.reporting.whole_file import write

if TYPE_CHECKING:
    from bench.online.follow import Followed
    from bench.online.paths import Tracking
    from bench.online.scenario import OnlineScenario
    from bench.reporting.frame import Line

OWN = Path("outputs/online_own")
"""Folder of the results on the user's own scenarios."""
COMMAND = "python -m bench -m experiment=online"


def force_of(text: str) -> Any:
    """Read a force: its kind, or its fields."""
    from bench.config.overrides import values_of

    forces = values_of("force", text)
    if len(forces) > 1:
        raise ValueError("one force")
    return forces[0] if isinstance(forces[0], Mapping) else {"kind": forces[0]}


def online(
    scenario: Annotated[
        tuple[str, ...], OneOf(scenario_names), f"scenarios of the track [all]: {', '.join(scenario_names())}"
    ] = (),
    method: Annotated[tuple[str, ...], "trackers, or window_<batch method> [those of the track]"] = (),
    system: Annotated[str, "a system of conf/system, in place of the scenarios of the track"] = "",
    varying: Annotated[
        Sequence[str],
        Others(("system",)),
        "system.varying.<parameter>=constant, step, ramp, sinusoid or random_walk, several with commas, or in "
        "full: 'system.varying.k={kind: step, change: -0.3, at: 0.5}'",
    ] = (),
    snr: Annotated[float | None, "signal-to-noise ratio (dB), with system= [20]"] = None,
    samples: Annotated[int | None, Within(ge=50), "number of samples, with system= [2000]"] = None,
    rate: Annotated[float | None, Within(gt=0, le=1e9), "sampling rate (1/s), with system= [20 per cycle]"] = None,
    force: Annotated[
        Mapping[str, Any] | None,
        Parsed(force_of),
        "multisine, white, coloured, impulses or '{kind: white, told: false}', with system=",
    ] = None,
    replicates: Annotated[int | None, Within(ge=1), "number of replicates at most [those of the track]"] = None,
    seed: Annotated[int, Within(ge=0, lt=2**63), "random seed"] = 0,
    workers: Workers = None,
    store: Annotated[Path, "folder of finished runs"] = Path("outputs/online"),
    out: Annotated[Path | None, "folder of table and picture [results, with system= outputs/online_own]"] = None,
    fit: Fit = True,
    dry_run: DryRun = False,
) -> int:
    """Track parameters that change during the record, sample by sample: the online track, Table 10.

    Finished runs are kept in the store, and the same command continues.
    """
    from bench.engine.pool import Limits
    from bench.online.paths import in_order

    stated = {"force": force, "snr": snr, "samples": samples, "rate": rate}
    scenarios = _scenarios(scenario, system, stated, varying)
    trackings, refused = _trackings(scenarios, method, replicates, seed)
    work = Work(store, out or (OWN if system else Path("results")), Limits(workers or usable_cores()), fit, dry_run)
    paths = in_order(trackings)
    if work.complete(paths, "run"):
        _write(trackings, refused, store, work.out)
        work.write_versions("table10", paths)
    return 0


def _scenarios(
    names: Sequence[str], system: str, fields: Mapping[str, Any], varying: Sequence[str]
) -> list[OnlineScenario]:
    """Return the named scenarios of the track, or those of a system of the user."""
    from bench.config.overrides import values_of

    if system and names:
        raise InputError("scenario", ",".join(names), "leave it out, since system= is given")
    stated = {name: value for name, value in fields.items() if value is not None}
    courses = {}
    for word in varying:
        key, _, text = word.partition("=")
        if not key.startswith(VARYING):
            raise InputError(key, text, "write system.varying.<parameter>=<kind>, e.g. system.varying.k=step")
        courses[key.removeprefix(VARYING)] = values_of(key, text)
    if system:
        return scenarios_from_system(system, courses, **stated)
    for name, value in {**stated, **{f"{VARYING}{name}": values for name, values in courses.items()}}.items():
        raise InputError(name, value, "use it with system=<name>; the scenarios of the track define their own")
    return [online_scenario(name) for name in names or scenario_names()]


def _trackings(
    scenarios: Sequence[OnlineScenario], method: Sequence[str], most: int | None, seed: int
) -> tuple[list[Tracking], list[Line]]:
    """Return what is to be computed, and a line for each method that cannot take a scenario."""
    from bench.entrants.online import make_online
    from bench.online.paths import Tracking

    content = online_track()
    settings = {name: dict(fields) for name, fields in content["variants"].items()}
    registered = {name: settings.get(name, {}).pop("method", name) for name in method or content["methods"]}
    made = {name: make_online(registered[name], settings.get(name, {})) for name in registered}
    tasks: list[Tracking] = []
    refused: list[Line] = []
    for scenario in scenarios:
        name = scenario.label
        left_out = content["left_out"].get(name, {"methods": [], "why": ""})
        for label, identifier in made.items():
            objection = identifier.objection(scenario.layout())
            if not objection and label in left_out["methods"] and not method:
                objection = left_out["why"]
            if objection:
                title = _title(label, registered[label])
                refused.append({"scenario": name, "method": label, "title": title, "message": objection})
                continue
            n = content["replicates_by_method"].get(label, content["replicates"])
            n = n if most is None else min(n, most)
            tasks.append(Tracking(scenario, registered[label], settings.get(label, {}), n, seed, label))
    return tasks, refused


def _title(label: str, method: str) -> str:
    """What a method is called; a variant by its settings' name."""
    from bench.entrants.online import online_card

    title = online_card(method).title
    return title if label == method else f"{title} ({label.removeprefix(method).strip('_')})"


def _write(tasks: Sequence[Tracking], refused: Sequence[Line], store: Path, out: Path) -> None:
    from bench.reporting.tables.online_table import table

    scenarios = {task.scenario.label: task.scenario for task in tasks}
    lines, shown = [], []
    for scenario in scenarios.values():
        scored_lines, drawn = _scored(scenario, [task for task in tasks if task.scenario == scenario], store)
        lines += [*scored_lines, *(line for line in refused if line["scenario"] == scenario.label)]
        if drawn is not None:
            shown.append(drawn)
    described = {name: scenario.describe() for name, scenario in scenarios.items()}
    for name, text in table(lines, described, COMMAND).items():
        write(out / name, text, out)
        print(out / name)
    try:
        from bench.reporting.pictures.responses import ShownTrack, draw_online
        from bench.reporting.pictures.style import save

        tracks = [ShownTrack(*content) for content in shown]
        print(*(save(draw_online(tracks), out / "figures") if tracks else []), sep="\n")
    except ImportError as error:
        LOG.warning("no picture: %s is not installed", error.name)


def _scored(scenario: OnlineScenario, tasks: Sequence[Tracking], store: Path) -> tuple[list[Line], Any]:
    """Return one line per method, and the content of the picture of the first replicate."""
    from bench.online.bound import bound_variances
    from bench.online.paths import read_paths
    from bench.online.score import score, score_bound, scored
    from bench.reporting.tables.online_table import BOUND, tracked

    count = max(task.replicates for task in tasks)
    streams = [scenario.stream(tasks[0].seed, i) for i in range(count)]
    bounds = [bound_variances(scenario, stream) for stream in streams]
    quantities = [q.name for q in streams[0].layout.system.groups]
    by_name = {q.name: q for q in streams[0].layout.quantities}
    least = {
        name: score_bound(scenario, streams, [bound[name] for bound in bounds], by_name[name]) for name in quantities
    }
    bound = {"scenario": scenario.label, "method": BOUND, "title": BOUND, "ok": count, "replicates": count}
    lines, drawn = tracked(bound, least), {}
    for task in tasks:
        kept = read_paths(store, task)
        title = _title(task.label, task.method)
        head = {
            "scenario": scenario.label, "method": task.label, "title": title, "replicates": task.replicates,
        }  # fmt: skip
        good = {i: path for i, path in kept.items() if np.isfinite(path.means).all(axis=1).any()}
        if not good:
            lines.append({**head, "message": "no run gave an estimate" if kept else "not run yet"})
            continue
        scores = {
            name: score(scenario, [scored(streams[i], path, bounds[i], name) for i, path in good.items()])
            for name in quantities
        }
        costs = {**_micros(list(good.values())), "held_bytes": max(path.held_bytes for path in good.values())}
        lines += tracked({**head, "ok": len(good), **costs}, scores)
        if 0 in good:
            drawn[title] = (good[0], scores[quantities[0]].excess)
    return lines, (scenario.label, streams[0], bounds[0], quantities[0], drawn) if drawn else None


def _micros(paths: Sequence[Followed]) -> dict[str, float]:
    """Return the median, 99 % quantile and maximum of the time per sample after the first estimate (µs)."""
    from bench.online.follow import first_estimate

    each = np.concatenate([path.micros[min(first_estimate(path) + 1, len(path.micros) - 1) :] for path in paths])
    times = np.quantile(each, [0.5, 0.99, 1.0]).tolist()
    return dict(zip(("micros_median", "micros_99", "micros_largest"), times, strict=True))
