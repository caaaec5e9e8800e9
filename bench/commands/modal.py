"""The modal track: ``python -m bench -m experiment=modal``."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from itertools import product
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

Fits = dict[tuple[str, str], "list[TrackFit]"]
"""The fits of all replicates by scenario and title of the method."""
COMMAND = "python -m bench -m experiment=modal"


def modal(
    scenario: Annotated[tuple[str, ...], OneOf(modal_scenario_names), "empty: all"] = (),
    method: Annotated[tuple[str, ...], "modal methods; empty: those of the track"] = (),
    replicates: Annotated[int | None, Within(ge=1), "number of records per scenario [that of the track]"] = None,
    seed: Annotated[int, Within(ge=0, lt=2**63), "random seed"] = 0,
    workers: Workers = None,
    store: Annotated[Path, "folder of finished fits"] = Path("outputs/modal"),
    out: Annotated[Path, "folder of the table"] = Path("results"),
    tex: Annotated[Path, "folder of the table in LaTeX"] = Path("build/tables"),
    fit: Fit = True,
    dry_run: DryRun = False,
) -> int:
    """Identify the modes of free decays and hammer blows: the modal track, Table 12.

    Finished fits are kept in the store, and the same command continues.
    """
    from bench.engine.pool import Limits
    from bench.reporting.tables.modal_table import modal_table

    scenarios = {name: modal_scenario(name) for name in scenario or modal_scenario_names()}
    fits, lines = _fits(scenarios.values(), method, replicates or modal_track()["replicates"], seed)
    work = Work(store, out, Limits(workers or usable_cores()), fit, dry_run)
    if not work.complete([task for tasks in fits.values() for task in tasks], "fit"):
        return 0
    lines += [line for name in scenarios for line in _scored(fits, name, store)]
    for name, text in modal_table(lines, {name: of.describe() for name, of in scenarios.items()}, COMMAND).items():
        folder = tex if name.endswith(".tex") else out
        write(folder / name, text, folder)
        print(folder / name)
    work.write_versions("table12", [task for tasks in fits.values() for task in tasks])
    return 0


def _fits(scenarios: Iterable[ModalScenario], names: Sequence[str], count: int, seed: int) -> tuple[Fits, list[Line]]:
    """Return the fits by scenario and method, and one line per method that is not applicable to a scenario."""
    from bench.entrants.modal import make_modal
    from bench.modal.paths import TrackFit

    fits: Fits = {}
    refused: list[Line] = []
    for name, of in product(names or modal_track()["methods"], scenarios):
        title = name
        try:
            method = make_modal(name)
            problem, title = of.draw(seed, 0)[0], method.card.title
            objection = method.objection(problem)
            if not names and not isinstance(problem.data, method.scope):
                continue  # a method for the other kind of data
        except InputError as error:
            if names:
                raise
            objection = error.remedy
        if objection:
            refused.append({"scenario": of.label, "method": title, "message": objection})
        else:
            fits[of.label, title] = [TrackFit(of, name, i, seed) for i in range(count)]
    return fits, refused


def _scored(fits: Fits, scenario: str, store: Path) -> Iterator[Line]:
    """Yield the lines of the bound and of each method on a scenario; a method without scores has the reason."""
    from bench.modal.bound import modal_bound
    from bench.modal.score import bound_scores, modal_scores
    from bench.reporting.tables.modal_table import BOUND

    by_title = {title: tasks for (label, title), tasks in fits.items() if label == scenario}
    truths = [task.scenario.draw(task.seed, task.replicate)[1] for task in next(iter(by_title.values()), [])]
    bounds = [modal_bound(truth) for truth in truths]
    lines = [{"method": BOUND, **row} for row in bound_scores(bounds)] if bounds else []
    for title, tasks in by_title.items():
        results = [task.read(store) for task in tasks]
        if any(result and result["status"] == "ok" for result in results):
            lines += [{"method": title, **row} for row in modal_scores(results, truths, bounds)]
        else:
            messages = Counter(r["message"] if r else "not run, or ended without a result" for r in results)
            lines.append({"method": title, "message": messages.most_common(1)[0][0]})
    yield from ({"scenario": scenario, **line} for line in lines)
