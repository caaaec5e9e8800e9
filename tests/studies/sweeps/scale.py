"""``python -m tests.studies.sweeps.scale``: a store of 100,000 cells: its collected view, status, and tables over it.

The cells are copies of one real cell under other identities, so that files have their real size. About 5 minutes, most
of them for writing the files; ``cells=20000`` shortens it.
"""

from __future__ import annotations

import json
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from bench.store.seal import sealed, unsealed
from bench.store.stored import FORMAT
from tests.studies.sweeps.common import bench, environment, finish

TABLES = """
import resource, sys, time
from pathlib import Path
from bench.store import index as view
from bench.store.store import Store
started = time.perf_counter()
table = view.summaries(Store(Path(sys.argv[1])), ["k_over_m_error_pct", "c_over_m_error_pct", "rmse"])
lines = table.groupby(["label", "system", "snr_db", "initial_state", "metric"])[["median", "excess"]].median()
Path(sys.argv[2]).write_text(lines.to_csv())
print(time.perf_counter() - started, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10, len(table), len(lines))
"""


def fill(store: Path, cells: int) -> int:
    """Copies of the one stored cell; returns its size in bytes."""
    (original,) = store.glob("*.json")
    content = unsealed(FORMAT, original.read_bytes())
    labels, levels = ("ls", "rls", "pinn", "shooting", "mcmc"), (40.0, 30.0, 20.0, 10.0, 5.0)
    for i in range(cells - 1):
        content |= {"identity": f"{i:020x}", "arrays": ""}
        content["cell"] |= {"label": labels[i % 5], "snr_db": levels[i // 5 % 5], "seed": i}
        text = json.dumps(content, ensure_ascii=False, separators=(",", ":"))
        (store / f"{i:020x}.json").write_bytes(sealed(FORMAT, text))
    return original.stat().st_size


def status(folder: Path) -> tuple[float, float, str]:
    """Seconds and memory (MB) of ``python -m bench.status``, and its last line but the reasons."""
    command = [sys.executable, "-m", "bench.status"]
    started = time.perf_counter()
    done = subprocess.run(command, cwd=folder, env=environment(folder), capture_output=True, text=True, check=True)
    seconds = time.perf_counter() - started
    memory = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 2**10
    return seconds, memory, next(line for line in done.stdout.splitlines() if " cells: " in line)


def main() -> int:
    """Print the table; exit status 1 where a claim does not hold."""
    given = [argument.partition("=")[2] for argument in sys.argv[1:] if argument.startswith("cells=")]
    cells = int(given[-1]) if given else 100_000
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        finish(bench(folder, "method=ls", "replicates=5", "workers=1"))
        store = folder / "outputs/rows"
        shutil.rmtree(store / "view", ignore_errors=True)
        size = fill(store, cells)
        print(f"{cells} cells of {size / 1024:.0f} KiB")
        first, first_memory, line = status(folder)
        print(f"first status, which collects the view: {first:.1f} s, {first_memory:.0f} MB")
        seconds, _, line = status(folder)
        print(f"status: {seconds:.2f} s: {line}")
        command = [sys.executable, "-c", TABLES, str(store), str(folder / "table.csv")]
        out = subprocess.run(command, cwd=folder, env=environment(folder), capture_output=True, text=True, check=True)
        table_s, table_mb, lines, groups = map(float, out.stdout.split())
        print(f"table over {lines:.0f} lines, {groups:.0f} groups: {table_s:.1f} s, {table_mb:.0f} MB")
        good = seconds <= 2 and table_s <= 10 and max(table_mb, first_memory) < 1000
        print("all hold" if good else "NOT all hold (status 2 s, tables 10 s, memory 1 GB)")
        return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
