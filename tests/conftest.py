"""What every test shares: one thread per process, the reference scenario, and a folder with its bound."""

from __future__ import annotations

import json
import math
import os
import random
import secrets
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
os.environ["VIBRATION_BENCH_ARCHIVE"] = "none"  # a test says itself what is published

import pytest  # noqa: E402
from hypothesis import HealthCheck, settings  # noqa: E402

from bench.engine import runner  # noqa: E402
from bench.engine.plan import plan  # noqa: E402
from bench.engine.pool import Limits  # noqa: E402
from bench.engine.runner import run_cells  # noqa: E402
from bench.entrants import registry  # noqa: E402
from bench.entrants.registry import REFERENCES, default_settings, load_method  # noqa: E402
from bench.information.fisher import Bound  # noqa: E402
from bench.scenario.scenario import PriorSpec, Scenario  # noqa: E402
from bench.store.bounds import Replicates, bound_identity, load_bounds  # noqa: E402
from bench.store.cell import Cell  # noqa: E402
from bench.store.seal import sealed  # noqa: E402
from bench.store.store import BOUND_FORMAT, Store  # noqa: E402
from bench.store.stored_cell import StoredCell  # noqa: E402
from bench.store.version import cell_version  # noqa: E402

FUZZ = settings(deadline=None, database=None, print_blob=False, suppress_health_check=list(HealthCheck))
settings.register_profile("quick", FUZZ, max_examples=150, derandomize=True)
settings.register_profile("long", FUZZ, max_examples=10_000)
settings.load_profile("quick")  # another one by --hypothesis-profile
REPOSITORY = Path(__file__).parents[1]
ONE_WORKER, TWO_WORKERS = Limits(1, 60.0, 2000.0), Limits(2, 60.0, 2000.0)


def pytest_configure(config: pytest.Config) -> None:
    """Keep what jax compiles beside pytest's own cache: for all processes of this run, and for the next one."""
    # as from a terminal, also where this runs under nohup or in a shell's background
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    cache = getattr(config, "cache", None)
    if cache is not None:
        os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(cache.mkdir("jax")))
        os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")


def install(site: Path, name: str, points: str) -> dict[str, str]:
    """Leave in a folder what pip would leave there of a package of entry points; returns the environment with it."""
    info = site / f"{name}-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(points)
    return {"PYTHONPATH": os.pathsep.join([str(site), os.environ.get("PYTHONPATH", "")])}


@pytest.fixture(scope="session")
def reference() -> Scenario:
    """What ``python -m bench method=<name>`` computes by default: the reference system at 20 dB, start known."""
    nominal = PriorSpec("nominal", {"mass": 0.02, "damping": 1.0, "stiffness": 0.5, "other": 0.5})
    parameters = {"m": 1.0, "c": 0.4, "k": 8.0}
    return Scenario("sdof", parameters, ((1.0,), (0.0,)), 20.0, prior=nominal, label="sdof")


@pytest.fixture(scope="session")
def bounds_folder(reference: Scenario, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that holds the bound of the reference scenario, computed once a test run."""
    folder = tmp_path_factory.mktemp("bounds")
    load_bounds([Replicates(reference)], folder)
    return folder


Plugins = Callable[..., None]
StoreFactory = Callable[[], Store]


@pytest.fixture
def plugins(monkeypatch: pytest.MonkeyPatch) -> Iterator[Plugins]:
    """Register test doubles of ``misbehaving`` as an installed package would: ``plugins("Wrong", "Draw")``."""
    cached = (load_method, cell_version)

    def register(*names: str) -> None:
        ours = {n.lower(): EntryPoint(name=n.lower(), value=f"misbehaving:{n}", group="bench.methods") for n in names}
        monkeypatch.setattr(registry, "registered", lambda: ours)
        for function in cached:
            function.cache_clear()

    yield register
    for function in cached:
        function.cache_clear()


@pytest.fixture
def new_store(tmp_path_factory: pytest.TempPathFactory, bounds_folder: Path) -> StoreFactory:
    """Makes empty stores that hold the bound of the reference scenario."""

    def make() -> Store:
        store = Store(tmp_path_factory.mktemp("store") / "rows")
        store.prepare()
        shutil.copytree(bounds_folder, store.bounds)
        return store

    return make


@pytest.fixture
def store(new_store: StoreFactory) -> Store:
    """An empty store that holds the bound of the reference scenario."""
    return new_store()


@pytest.fixture
def any_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    """A bound that says nothing, where a test is not about bounds and its scenarios are many."""
    empty = Bound(("m", "c", "k"), {"m": math.inf}, {"m": False}, {"m": 0.0}, 0.1, 0.1, ())

    def write(wanted: Any, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        for one in wanted:
            (folder / f"{bound_identity(one)}.bound").write_bytes(sealed(BOUND_FORMAT, json.dumps(asdict(empty))))

    def make(wanted: Any, store: Store, *_: Any) -> dict[str, str]:
        write(wanted, store.bounds)
        return {}

    monkeypatch.setattr(runner, "make_bounds", make)


def damaged(paths: Sequence[Path], n: int) -> Iterator[Path]:
    """Damage files in turn, ``n`` times in all, by a flipped bit or, every tenth, a cut; each is mended afterwards."""
    seed = secrets.randbits(32)
    print(f"seed {seed}")
    rng = random.Random(seed)
    for i in range(n):
        path = paths[i % len(paths)]
        whole = path.read_bytes()
        place = rng.randrange(len(whole))
        flipped = bytes([whole[place] ^ 1 << rng.randrange(8)]) + whole[place + 1 :]
        path.write_bytes(whole[:place] + (flipped if i % 10 else b""))
        yield path
        path.write_bytes(whole)


def a_cell(scenario: Scenario, method: str, replicates: int = 2, seed: int = 0, **given: Any) -> Cell:
    """Return a cell of a method whose other settings are the default ones."""
    known = {} if method in REFERENCES else default_settings(method)
    return Cell(scenario, method, {**known, **given}, replicates, seed, method)


def computed(store: Store, *cells: Cell, limits: Limits = TWO_WORKERS) -> list[StoredCell]:
    """Compute cells, and return them as they are stored."""
    run_cells(plan(cells, store), store, limits)
    stored = [store.load(cell.identity) for cell in cells]
    assert all(stored)
    return [cell for cell in stored if cell]


Python = Callable[..., "subprocess.CompletedProcess[str]"]


@pytest.fixture
def python(tmp_path: Path) -> Python:
    """Run this Python with arguments in an empty folder: ``python("-m", "bench", ...)``."""
    empty = tmp_path / "empty"
    empty.mkdir()

    def run(*arguments: str, env: Mapping[str, str] | None = None) -> subprocess.CompletedProcess[str]:
        environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1", **(env or {})}
        command = [sys.executable, *arguments]
        return subprocess.run(command, cwd=empty, env=environment, capture_output=True, text=True, timeout=300)

    return run


@pytest.fixture(scope="session")
def forked() -> Iterator[Any]:
    """A process that forks for many commands."""
    from forked import Forked

    process = Forked()
    yield process
    process.close()


@pytest.fixture(scope="session")
def one_cell(tmp_path_factory: pytest.TempPathFactory, forked: Any) -> Path:
    """A store with one cell, of a method that takes no time, in a folder that anybody may enter."""
    from forked import Call

    folder = tmp_path_factory.mktemp("own")
    line = "method=prior replicates=2 workers=1 store=rows archive=none"
    assert forked.run(Call(line.split(), str(folder))).status == 0
    return folder / "rows"


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print what tests have noted, such as the seed of a random draw."""
    reports = [report for group in terminalreporter.stats.values() for report in group]
    notes = {str(text) for report in reports for name, text in getattr(report, "user_properties", ()) if name == "note"}
    for note in sorted(notes):
        terminalreporter.write_line(note)


@pytest.fixture(scope="session")
def six(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A round of six problems, one of each kind, and the folder of its secret; copy them before changing anything."""
    from bench.rounds.folder import write_round

    place = tmp_path_factory.mktemp("rounds")
    write_round(place / "six", place / "six_secret", 2**255 + 7, 6)
    return place / "six", place / "six_secret"
