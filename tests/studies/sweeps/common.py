"""What the scripts share: an environment with the stand-in methods, and sweeps as child processes."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from bench.store.store import Store

ROOT = Path(__file__).parents[3]
METHODS = {"empty": "tests.studies.sweeps.doubles:Empty", "busy": "tests.studies.sweeps.doubles:Busy"}


def environment(folder: Path) -> dict[str, str]:
    """An environment in which the stand-ins are registered as an installed package's methods are."""
    info = folder / "site" / "stand_ins-0.dist-info"
    info.mkdir(parents=True, exist_ok=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: stand-ins\nVersion: 0\n")
    lines = "".join(f"{name} = {value}\n" for name, value in METHODS.items())
    (info / "entry_points.txt").write_text(f"[bench.methods]\n{lines}")
    path = os.pathsep.join([str(ROOT), str(info.parent), os.environ.get("PYTHONPATH", "")])
    return {**os.environ, "PYTHONPATH": path.rstrip(os.pathsep), "VIBRATION_BENCH_ARCHIVE": "none"}


def bench(folder: Path, *arguments: str, log: str = "bench.log") -> subprocess.Popen[str]:
    """``python -m bench`` started in a folder; what it says on the error stream goes to a log there."""
    command = [sys.executable, "-m", "bench", *arguments]
    with (folder / log).open("a") as errors:
        return subprocess.Popen(
            command, cwd=folder, env=environment(folder), stdout=subprocess.PIPE, stderr=errors, text=True
        )


def finish(process: subprocess.Popen[str]) -> tuple[int, str]:
    """Exit status and standard output, when it ends."""
    out, _ = process.communicate()
    return process.returncode, out


def cell_files(store: Path) -> list[str]:
    """Names of the stored cells."""
    return sorted(path.name for path in store.glob("*.json"))


def csv(store: Path) -> str:
    """A table of all that was computed: every metric of every cell, as text."""
    lines = [
        {**{name: cell.cell.get(name) for name in ("label", "system", "snr_db", "seed")}, "identity": cell.identity,
         "n_ok": cell.n_ok, "data": cell.provenance.get("data"), "metric": metric, **statistics}
        for cell in Store(store) for metric, statistics in cell.summary.items()
    ]  # fmt: skip
    return str(pd.DataFrame(lines).sort_values(["identity", "metric"]).to_csv(index=False))


def report(title: str, rows: Sequence[tuple[str, object, object]]) -> int:
    """Print measured against wanted; the exit status, 0 where all hold."""
    print(title)
    good = True
    for what, found, wanted in rows:
        holds = found == wanted if not isinstance(wanted, bool) else bool(found) is wanted
        good &= holds
        print(f"  {'ok ' if holds else 'NOT'} {what}: {found} (wanted {wanted})")
    return 0 if good else 1
