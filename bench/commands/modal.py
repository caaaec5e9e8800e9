"""The modal track: ``python -m bench -m experiment=modal``."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from bench.commands.declaration import OneOf, Within
from bench.commands.work import DryRun, Fit, Work, Workers
from bench.config.modal import modal_scenario, modal_scenario_names, modal_track
from bench.errors import InputError
from bench.isolation.machine import usable_cores
from bench.reporting.whole_file import write

if TYPE_CHECKING:
    from bench.modal.paths import TrackFit
    from bench.modal.scenario import ModalScenario
    from bench.reporting.frame import Line

COMMAND = "python -m bench -m experiment=modal"


def modal(
    scenario: Annotated[tuple[str, ...], OneOf(modal_scenario_names), "empty: all"] = (),
    method: Annotated[tuple[str, ...], "modal methods; empty: those of the track"] = (),
    replicates: Annotated[int | None, Within(ge=1), "at most so many [those of the track]"] = None,
    seed: Annotated[int, Within(ge=0, lt=2**63), "of all random streams"] = 0,
    workers: Workers = None,
    store: Annotated[Path, "folder of finished fits"] = Path("outputs/modal"),
    out: Annotated[Path, "folder of the table"] = Path("results"),
    tex: Annotated[Path, "folder of the table in LaTeX"] = Path("build/tables"),
    fit: Fit = True,
    dry_run: DryRun = False,
) -> int:
    """Identify the modes of free decays and hammer blows, beside the bound: the modal track, Table 12.

    Finished fits are kept in the store, and the same command goes on from them.
    """
    from bench.engine.pool import Limits
    from bench.reporting.tables.modal_table import modal_table

    scenarios = [modal_scenario(name) for name in scenario or modal_scenario_names()]
    fits, lines = _fits(scenarios, method, replicates, seed)
    work = Work(store, out, Limits(workers or usable_cores()), fit, dry_run)
    if not work.complete([task for tasks in fits.values() for task in tasks], "fit"):
        return 0
    for each in scenarios:
        lines += _lines(each, {title: tasks for (label, title), tasks in fits.items() if label == each.label}, store)
    for name, text in modal_table(lines, {each.label: each.describe() for each in scenarios}, COMMAND).items():
        folder = tex if name.endswith(".tex") else out
        write(folder / name, text, folder)
        print(folder / name)
    return 0


def _fits(
    scenarios: Sequence[ModalScenario], names: Sequence[str], most: int | None, seed: int
) -> tuple[dict[tuple[str, str], list[TrackFit]], list[Line]]:
    """Return the fits by scenario and title of the method, and a line for each method that cannot serve a scenario."""
    from bench.entrants.modal import make_modal
    from bench.modal.paths import TrackFit

    track = modal_track()
    fits: dict[tuple[str, str], list[TrackFit]] = {}
    refused: list[Line] = []
    for name in names or track["methods"]:
        n = track["replicates_by_method"].get(name, track["replicates"])
        try:
            method = make_modal(name)
        except InputError as error:
            if names:
                raise
            refused += [{"scenario": of.label, "method": name, "message": error.remedy} for of in scenarios]
            continue
        for of in scenarios:
            if objection := method.objection(of.draw(seed, 0)[0]):
                refused.append({"scenario": of.label, "method": method.card.title, "message": objection})
            else:
                replicates = range(n if most is None else min(n, most))
                fits[of.label, method.card.title] = [TrackFit(of, name, i, seed) for i in replicates]
    return fits, refused


def _lines(scenario: ModalScenario, fits: Mapping[str, Sequence[TrackFit]], store: Path) -> list[Line]:
    """Return the lines of the bound and of each method, or one that says why a method has no scores."""
    from bench.modal.bound import modal_bound
    from bench.modal.score import bound_scores, modal_scores
    from bench.reporting.tables.modal_table import BOUND

    replicates = max(fits.values(), key=len, default=())
    truths = [fit.scenario.draw(fit.seed, fit.replicate)[1] for fit in replicates]
    bounds = [modal_bound(truth) for truth in truths]
    lines = [{"method": BOUND, **row} for row in bound_scores(bounds)] if bounds else []
    for title, of_method in fits.items():
        results = [fit.read(store) for fit in of_method]
        n = len(results)
        if any(result and result["status"] == "ok" for result in results):
            lines += [{"method": title, **row} for row in modal_scores(results, truths[:n], bounds[:n])]
        else:
            said = Counter(result["message"] if result else "not run, or ended without a result" for result in results)
            lines.append({"method": title, "message": said.most_common(1)[0][0]})
    return [{"scenario": scenario.label, **line} for line in lines]
