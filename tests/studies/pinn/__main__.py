"""Cost and reliability of the PINN engine, as a page."""

from __future__ import annotations

import json
import platform
import sys
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Annotated

from bench.commands.declaration import OneOf
from bench.config.experiment import expand
from bench.errors import InputError
from bench.isolation.machine import single_threaded
from bench.reporting.tables.render import markdown_table
from bench.reporting.whole_file import write
from tests.studies.common import RESULTS, Count, Out, publish, study
from tests.studies.pinn import pictures
from tests.studies.pinn.common import Part

PARTS = ("rivals", "accuracy", "systems", "initialisations", "starting_values", "steps", "scaling")
MACHINE = (
    "with `peers=` and `peer_python=` for the rivals' times. The rivals' part is timed by the clock on one core, the "
    "others in processor seconds; compare times within one part only."
)


def pinn(
    part: Annotated[tuple[str, ...], OneOf(PARTS), "parts to run; left out: all"] = (),
    replicates: Annotated[Count, "data sets of a scenario"] = 100,
    out: Out = RESULTS,
    fit: Annotated[bool, "false: page and pictures of what is stored"] = True,
    peers: Annotated[Path | None, "folder of rival scripts, which are then timed"] = None,
    peer_python: Annotated[Path | None, "interpreter that has DeepXDE"] = None,
    seeds: Annotated[Count, "fits of each rival"] = 3,
) -> int:
    """Measure what the PINN engine costs and how far it can be trusted: pinn.md and its pictures.

    Each part is stored when it is done (<out>/pinn/<part>.json); the page is made from what is stored.
    """
    if peers and not (peers / "naive_fit.py").is_file():
        raise InputError("peers", peers, "a folder that holds naive_fit.py")
    if peer_python and not peer_python.is_file():
        raise InputError("peer_python", peer_python, "the path of a Python interpreter")
    single_threaded()
    folder, compute = out / "pinn", parts(replicates, peers, peer_python, seeds) if fit else {}
    for name in (part or PARTS) if fit else ():
        result = compute[name]()
        print(f"\n{result.title}\n\n{markdown_table(result.rows, result.columns)}", flush=True)
        content = {**asdict(result), "python": platform.python_version()}
        write(folder / f"{name}.json", json.dumps(content, indent=1) + "\n", out)
    stored = folder / "scaling.json"
    if stored.is_file() and (data := json.loads(stored.read_text(encoding="utf-8"))["data"]):
        print(*pictures.scaling_picture(data, out / "figures"), sep="\n")
    publish(out / "pinn.md", page(folder))
    return 0


def parts(replicates: int, peers: Path | None, peer_python: Path | None, seeds: int) -> dict[str, Callable[[], Part]]:
    """Return what computes each part."""
    from tests.studies.pinn import rivals, robustness, scaling

    adam = dict(expand(["method=pinn_adam"], multirun=False)[0].cell().settings)
    return {
        "rivals": lambda: rivals.rivals(peers, peer_python, seeds, adam),
        "accuracy": lambda: robustness.accuracy(replicates),
        "systems": lambda: robustness.systems(max(1, replicates // 2)),
        "initialisations": lambda: robustness.initialisations(50),
        "starting_values": robustness.starting_values,
        "steps": lambda: robustness.steps(adam),
        "scaling": lambda: scaling.scaling(min(5, replicates)),
    }


def page(folder: Path) -> str:
    """Return all stored parts as one page."""
    sections = ["# The PINN engine", f"Regenerate: `python -m tests.studies.pinn`, {MACHINE}"]
    for name in PARTS:
        path = folder / f"{name}.json"
        if path.is_file():
            part = json.loads(path.read_text(encoding="utf-8"))
            sections += [f"## {part['title']}", part["text"], markdown_table(part["rows"], part["columns"])]
            if name == "scaling" and part["data"]:
                sections += [f"![{part['title']}](figures/pinn_scaling.png)", pictures.scaling_caption(part["data"])]
    return "\n\n".join(sections) + "\n"


main = partial(study, pinn, "tests.studies.pinn")

if __name__ == "__main__":
    sys.exit(main())
