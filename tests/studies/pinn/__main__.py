"""``python -m tests.studies.pinn``: what the PINN engine costs and how far it can be trusted, as a page.

Each part is stored when it is done (``<out>/pinn/<part>.json``), and the page ``<out>/pinn.md`` and its pictures are
made from what is stored; ``part=`` runs some of them only, ``fit=false`` none. Rival scripts are timed where ``peers=``
names their folder.
"""

from __future__ import annotations

import json
import platform
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

from tabulate import tabulate

from bench.config.experiment import expand
from bench.engine.progress import counter
from bench.errors import InputError
from bench.isolation.machine import single_threaded
from bench.store.store import Store
from tests.studies.fields import command, flag, read_fields, whole
from tests.studies.pinn import pictures
from tests.studies.pinn.common import Part

PARTS = (
    "rivals",
    "memory",
    "accuracy",
    "systems",
    "initialisations",
    "starting_values",
    "loss",
    "steps",
    "reach",
    "scaling",
)
USAGE = """usage: python -m tests.studies.pinn [part=<a,b>] [replicates=100] [out=results] [fit=true]
                                        [peers=<folder of rival scripts> [peer_python=<python with DeepXDE>] [seeds=3]]
parts: """ + ", ".join(PARTS)


def options(arguments: Sequence[str]) -> dict[str, str]:
    """The arguments, checked; raises InputError."""
    found = {
        "part": ",".join(PARTS),
        "replicates": "100",
        "out": "results",
        "peers": "",
        "peer_python": "",
        "seeds": "3",
        "fit": "true",
    }
    found = read_fields(arguments, found)
    for part in found["part"].split(","):
        if part not in PARTS:
            raise InputError("part", part, f"one of {', '.join(PARTS)}")
    flag("fit", found["fit"])
    for name in ("replicates", "seeds"):
        whole(name, found[name])
    if found["peers"] and not (Path(found["peers"]) / "naive_fit.py").is_file():
        raise InputError("peers", found["peers"], "a folder that holds naive_fit.py")
    if found["peer_python"] and not Path(found["peer_python"]).is_file():
        raise InputError("peer_python", found["peer_python"], "the path of a Python interpreter")
    return found


def run(part: str, chosen: dict[str, str]) -> Part:
    """One part, with a progress bar where it is long."""
    from tests.studies.pinn import reach, rivals, robustness, scaling

    adam = dict(expand(["method=pinn_adam"], multirun=False)[0].cell().settings)
    replicates = int(chosen["replicates"])
    few = max(1, min(5, replicates))
    peers = Path(chosen["peers"]) if chosen["peers"] else None
    parts: dict[str, tuple[int, Callable[[], Part]]] = {
        "rivals": (
            0,
            lambda: rivals.rivals(peers, chosen["peer_python"] or None, int(chosen["seeds"]), sys.executable, adam),
        ),
        "memory": (0, lambda: robustness.memory(adam)),
        "accuracy": (20 * replicates, lambda: robustness.accuracy(replicates, advance)),
        "systems": (8 * max(1, replicates // 2), lambda: robustness.systems(max(1, replicates // 2), advance)),
        "initialisations": (100, lambda: robustness.initialisations(50, advance)),
        "starting_values": (400, lambda: robustness.starting_values(advance)),
        "loss": (0, lambda: robustness.loss(adam)),
        "steps": (len(robustness.BUDGETS) * 6, lambda: robustness.steps(adam, advance)),
        "reach": (reach.COUNT, lambda: reach.reach(few, advance)),
        "scaling": (scaling.COUNT, lambda: scaling.scaling(few, advance)),
    }
    number, compute = parts[part]
    with counter("fit", number) as advance:
        return compute()


def page(folder: Path) -> str:
    """All stored parts as one page."""
    sections = ["# The PINN engine", "Regenerate: `python -m tests.studies.pinn`, " + MACHINE]
    for name in PARTS:
        path = folder / f"{name}.json"
        if path.is_file():
            part = json.loads(path.read_text(encoding="utf-8"))
            table = tabulate(part["rows"], headers=part["columns"], tablefmt="github", disable_numparse=True)
            sections += [f"## {part['title']}", part["text"], table]
            if part["data"]:
                caption = getattr(pictures, f"{name}_caption")(part["data"])
                sections += [f"![{part['title']}](figures/pinn_{name}.png)", caption]
    return "\n\n".join(sections) + "\n"


def drawn(folder: Path, out: Path) -> list[Path]:
    """The pictures of all stored parts that have numbers for one."""
    found: list[Path] = []
    for path in (folder / f"{name}.json" for name in PARTS):
        data = json.loads(path.read_text(encoding="utf-8"))["data"] if path.is_file() else {}
        found += getattr(pictures, f"{path.stem}_picture")(data, out) if data else []
    return found


MACHINE = (
    "with `peers=` and `peer_python=` for the rivals' times. The rivals' part is timed by the clock on one core, the "
    "others in processor seconds; compare times within one part only."
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the parts and write the page; exit status 2 for bad input."""
    return command("tests.studies.pinn", f"{USAGE}\n\n{__doc__}", argv, _main)


def _main(arguments: Sequence[str]) -> int:
    single_threaded()
    chosen = options(arguments)
    out = Path(chosen["out"])
    folder = out / "pinn"
    Store(folder).prepare()
    Store(out / "figures").prepare()
    for name in chosen["part"].split(",") if flag("fit", chosen["fit"]) else []:
        part = run(name, chosen)
        print(f"\n{part.title}\n\n{tabulate(part.rows, headers=part.columns, disable_numparse=True)}", flush=True)
        content = {**asdict(part), "python": platform.python_version()}
        (folder / f"{name}.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    for path in drawn(folder, out / "figures"):
        print(path)
    (out / "pinn.md").write_text(page(folder), encoding="utf-8")
    print(out / "pinn.md")
    return 0


if __name__ == "__main__":
    sys.exit(main())
