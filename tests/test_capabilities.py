"""What a user can do, once each, by the command or call that they would type, on the smallest data that shows it.

Each test quotes the capability that it holds. Nothing here knows how a capability is made, so these tests stay while
the code below them changes. The kit, exports, damaged stores, bad input and the Python interface are used in the same
way in ``tests/bench``: in its folders exchange, conformance, store, commands and face.

Commands run in this process, which spares their imports, except where one is killed, writes to a terminal or finds
packages of the user's own.
"""

from __future__ import annotations

import contextlib
import csv
import io
import json
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import REPOSITORY, install

import bench
from bench.commands.main import main
from bench.entrants.registry import method_names, missing_package

CONF, ARCHIVE = REPOSITORY / "conf", REPOSITORY / "results" / "archive"
METHODS = """
from dataclasses import dataclass
import gc, pathlib, time
import numpy as np
from bench import Card, Estimate, Identifier, Normal

@dataclass(frozen=True)
class Nominal(Identifier):
    seconds: float = 0.0
    log: str = ""
    card = Card("a method of the tests", "not used", "native", "simulated", "the prior's", "none")

    def estimate(self, problem, rng):
        if self.log:
            with pathlib.Path(self.log).open("a") as lines:
                lines.write("fit\\n")
        time.sleep(self.seconds)
        prior = problem.prior
        distribution = Normal(prior.names, prior.log_mean, np.diag(prior.log_sds**2), log=True)
        return Estimate(problem.system, parameters=distribution)

class Hangs(Nominal):
    def estimate(self, problem, rng):
        time.sleep(1e6)

class Grows(Nominal):
    def estimate(self, problem, rng):
        return np.ones(2**33).sum()

class Raises(Nominal):
    def estimate(self, problem, rng):
        raise ValueError("no idea")

class Spies(Nominal):
    def estimate(self, problem, rng):
        seed = getattr(rng.bit_generator, "seed_seq", None)
        known = [type(thing).__name__ for thing in gc.get_objects() if type(thing).__name__ in ("Truth", "Scenario")]
        raise ValueError(f"entropy {getattr(seed, 'entropy', None)} key {getattr(seed, 'spawn_key', ())} {known}")
"""
SYSTEM = """
from bench.systems.linear import SDOF

class Rig(SDOF):
    pass
"""
OWN = ("nominal", "hangs", "grows", "raises", "spies")


@dataclass(frozen=True)
class Done:
    """What a command printed."""

    stdout: str
    stderr: str


def run(line: str, folder: Path, status: int = 0, stdin: str = "") -> Done:
    """Run a command line, without ``python -m bench``, in a folder, and check its exit status."""
    out, err = io.StringIO(), io.StringIO()
    streams = contextlib.redirect_stdout(out), contextlib.redirect_stderr(err)
    with contextlib.chdir(folder), pytest.MonkeyPatch.context() as patch, streams[0], streams[1]:
        patch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(stdin.encode())))
        patch.setenv("COLUMNS", "200")
        try:
            ended = main(shlex.split(line))
        except SystemExit as end:
            ended = int(end.code or 0)
    assert ended == status, (line, out.getvalue()[-2000:], err.getvalue()[-2000:])
    return Done(out.getvalue(), err.getvalue())


def results(line: str, folder: Path) -> list[dict[str, Any]]:
    """Run cells with ``format=json`` and return one result a cell."""
    return [json.loads(result) for result in run(f"{line} format=json", folder).stdout.splitlines()]


def started(line: str, folder: Path, packages: dict[str, str], **streams: Any) -> subprocess.Popen[bytes]:
    """Start a command line in a process of its own, with the user's own packages."""
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1", "COLUMNS": "200", **packages}
    quiet = dict.fromkeys(("stdout", "stderr"), subprocess.DEVNULL)
    command = [sys.executable, "-m", "bench", *shlex.split(line)]
    return subprocess.Popen(command, cwd=folder, env=environment, **{**quiet, **streams})


def stored(folder: Path) -> list[str]:
    """Return what names the finished cells of a store."""
    return sorted(path.stem for path in folder.glob("*.*") if re.fullmatch(r"[0-9a-f]{20}", path.stem))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that a user works in, whose store ``outputs/rows`` has six small cells."""
    folder = tmp_path_factory.mktemp("user")
    run("-m method=ls,oracle,shooting snr=20,40 replicates=3 workers=1", folder)
    return folder


@pytest.fixture(scope="module")
def packages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Variables by which a Python finds installed packages with methods and a system of the user's own."""
    folder = tmp_path_factory.mktemp("packages")
    (folder / "own_methods.py").write_text(METHODS)
    (folder / "own_system.py").write_text(SYSTEM)
    points = "".join(f"{name} = own_methods:{name.title()}\n" for name in OWN)
    return install(folder, "own_methods", f"[bench.methods]\n{points}[bench.systems]\nrig = own_system:Rig\n")


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A measured free decay: c/m = 0.2 1/s, k/m = 9.01 1/s²."""
    path = tmp_path_factory.mktemp("record") / "record.csv"
    write_decay(path, 5)
    return path


def write_decay(path: Path, seed: int) -> None:
    times = np.linspace(0.0, 12.0, 90)
    decay = np.exp(-0.1 * times) * np.cos(3.0 * times) + 0.01 * np.random.default_rng(seed).standard_normal(90)
    np.savetxt(path, np.column_stack([times, 1e3 * decay]), delimiter=",", header="t [s],x [mm]", comments="")


# ---- cells and sweeps


def test_one_cell(folder: Path) -> None:
    """``python -m bench method=pinn snr=10``"""
    text = run("method=pinn snr=10 replicates=1 workers=1", folder).stdout
    assert "pinn on sdof, 10 dB" in text
    assert re.search(r"k/m %\s+\d", text)
    assert "bound" in text


def test_a_sweep(tmp_path: Path) -> None:
    """``-m method=... snr=... system=... seed=range(...)``"""
    line = "-m method=prior,oracle snr=20,40 system=sdof,sdof_heavy 'seed=range(0,2)' replicates=1"
    found = results(line, tmp_path)
    assert len({one["cell"] for one in found}) == 2 * 2 * 2 * 2
    assert {(one["system"], one["snr"], one["seed"]) for one in found} >= {("sdof", 20.0, 0), ("sdof_heavy", 40.0, 1)}


def test_every_experiment_is_a_list_of_cells(tmp_path: Path) -> None:
    """every experiment of ``conf/experiment``"""
    for path in (CONF / "experiment").glob("*.yaml"):
        assert len(bench.experiment(path.stem)) > 1, path.stem
    found = results("-m experiment=table3 method=prior replicates=1 workers=1", tmp_path)
    assert {(one["method"], one["initial_state"]) for one in found} == {("prior", "known"), ("prior", "unknown")}


def test_fields_of_scenario_prior_disturbance_and_method(tmp_path: Path) -> None:
    """fields of scenario, prior, disturbance, method settings"""
    (plain,) = results("method=ls replicates=1", tmp_path)
    (other,) = results(
        "method=ls replicates=1 system.samples=60 system.parameters.c=0.8 prior=wide_mass "
        "disturbance=outliers disturbance.size=20 method.derivative=spline",
        tmp_path,
    )
    assert (other["prior"], other["disturbance"]) == ("wide_mass", "outliers")
    assert other["cell"] != plain["cell"]
    bounds = [one["metrics"]["c_over_m_error_pct"]["bound"] for one in (plain, other)]
    assert bounds[1] < bounds[0]  # more samples of a more damped motion


def test_own_methods_and_systems_limits_and_failures(packages: dict[str, str], tmp_path: Path) -> None:
    """own system, method and scenario files and entry points; limits of time and memory a fit, failed replicates as
    rows with a status; **No truth reaches a method.**
    """
    text = (CONF / "system" / "sdof.yaml").read_text()
    rig = text.replace("kind: sdof", "kind: rig").replace("label: sdof", "label: my rig")
    (tmp_path / "my_rig.yaml").write_text(rig)
    line = (
        f"-m method={','.join(OWN)} system=my_rig.yaml seed=12345 replicates=1 timeout_s=3 memory_mb=1000 format=json"
    )
    out, _ = started(line, tmp_path, packages, stdout=subprocess.PIPE).communicate(timeout=300)
    found = {one["method"]: one for one in map(json.loads, out.splitlines())}
    assert {one["system"] for one in found.values()} == {"my rig"}
    statuses = {"hangs": "timeout", "grows": "oom", "raises": "crashed", "spies": "crashed", "nominal": "ok"}
    assert {name: one["status"] for name, one in found.items()} == statuses
    message = found["spies"]["message"]
    assert "entropy" in message
    assert "12345" not in message
    assert message.endswith("[]")


def test_resume_after_kill_9_by_two_drivers(packages: dict[str, str], tmp_path: Path) -> None:
    """resume after kill -9 without a lost or doubled cell; two drivers on one store; Ctrl-C keeps finished cells"""
    store, log = tmp_path / "rows", tmp_path / "log"
    sweep = (
        f"-m method=nominal method.seconds=0.2 method.log={log} 'seed=range(0,6)' replicates=2 workers=1 store={store}"
    )

    def stamps() -> dict[str, list[int]]:
        return {name: [p.stat().st_mtime_ns for p in store.glob(f"{name}.*")] for name in stored(store)}

    for cells, number, status in ((1, signal.SIGINT, 130), (2, signal.SIGKILL, -9)):
        driver = started(sweep, tmp_path, packages, start_new_session=True)
        until = time.monotonic() + 120
        while len(stored(store)) < cells and time.monotonic() < until:
            time.sleep(0.02)
        driver.send_signal(number)
        assert driver.wait(timeout=60) == status
        assert cells <= len(stored(store)) < 6
    time.sleep(1.0)  # the fits of the killed driver end with it
    assert not list(store.glob("*.tmp"))
    before, fits = stamps(), len(log.read_text().splitlines())
    drivers = [started(sweep, tmp_path, packages) for _ in range(2)]
    assert [driver.wait(timeout=200) for driver in drivers] == [0, 0]
    after = stamps()
    assert len(after) == 6
    assert before.items() <= after.items()
    assert len(log.read_text().splitlines()) - fits == 2 * (6 - len(before))  # no fit twice


@pytest.mark.slow
@pytest.mark.parametrize(("launcher", "package"), [("ray", "ray"), ("submitit_local", "submitit")])
def test_jobs_of_ray_and_as_slurm_runs_them(
    launcher: str, package: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ray and Slurm; Slurm's daemons are tried by ``tests.studies.sweeps``"""
    pytest.importorskip(package)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    line = f"-m method=prior,oracle replicates=2 cells_per_job=1 hydra/launcher={launcher} format=json"
    out, _ = started(line, tmp_path, {}, stdout=subprocess.PIPE).communicate(timeout=300)
    assert [json.loads(one)["n_ok"] for one in out.splitlines()] == [2, 2]


def test_progress_with_time_left(packages: dict[str, str], tmp_path: Path) -> None:
    """progress with time left; in a terminal"""
    screen, terminal = os.openpty()
    line = "-m method=nominal method.seconds=0.2 snr=20,30 replicates=10 workers=1"
    sweep = started(line, tmp_path, packages, stdin=terminal, stderr=terminal)
    os.close(terminal)
    shown = b""
    with contextlib.suppress(OSError):  # the terminal's other end is closed
        while piece := os.read(screen, 4096):
            shown += piece
    os.close(screen)
    assert sweep.wait() == 0
    assert re.search(r"[1-9]/20 fits", shown.decode())
    assert "left" in shown.decode()


def test_status_reproduction_and_json_of_a_store(folder: Path) -> None:
    """``status``, ``reproduce <id>``; JSON output"""
    text = run("status method=ls,rls snr=20 replicates=3", folder).stdout
    assert re.search(r"ls +sdof 20 dB known +3 +done", text)
    assert re.search(r"rls +sdof 20 dB known +3 +missing", text)
    assert re.search(r"\d+ cells: \d+ done", run("status", folder).stdout)
    (one,) = results("method=ls snr=20 replicates=3", folder)
    assert one["n_ok"] == one["replicates"] == 3
    assert re.search("identical|within tolerance", run(f"reproduce cell={one['cell']}", folder).stdout)
    (one,) = results("method=oracle snr=20 replicates=3", folder)
    metric = one["metrics"]["k_over_m_error_pct"]
    assert 0.1 < metric["median"] / metric["bound"] < 10


def test_store_and_archive_are_read_together(tmp_path: Path) -> None:
    """store and archive read together"""
    line = "-m experiment=table3 method=prior dry_run=true archive="
    assert "2 cells: 2 missing" in run(f"{line}none", tmp_path).stdout
    assert re.search("2 cells: 2 (done|stale)", run(f"{line}{ARCHIVE}", tmp_path).stdout)


def test_hydra_habits(tmp_path: Path) -> None:
    """the Hydra habits people have: ``--cfg job``, ``--help``, ``+experiment=``, shell completion"""
    assert "snr" in run("method=pinn snr=10 --cfg job", tmp_path).stdout
    assert "method" in run("--help", tmp_path).stdout
    assert "prior" in run("-m +experiment=table3 method=prior dry_run=true", tmp_path).stdout
    assert "complete" in run("--shell-completion install=bash", tmp_path).stdout


# ---- methods

VARIANTS = {path.stem for path in (CONF / "method").glob("*.yaml")}
QUICK_METHODS = ("ar", "ar_recursive", "ekf", "era", "frequency", "iqml", "log_decrement", "ls", "matrix_pencil", "rls")


def test_quick_methods_answer_on_one_mass(tmp_path: Path) -> None:
    """All 25 methods and their variants; all methods on all systems they serve"""
    assert len(set(method_names()) - {"prior", "oracle"}) >= 25
    assert len(VARIANTS - set(method_names())) >= 13
    line = f"-m method={','.join(QUICK_METHODS)} snr=40 replicates=1 initial_state=unknown"
    found = results(line, tmp_path)
    assert {one["method"]: one["status"] for one in found} == dict.fromkeys(QUICK_METHODS, "ok")
    errors = [one["metrics"]["k_over_m_error_pct"]["median"] for one in found]
    assert sorted(errors)[len(errors) // 2] < 2.0


@pytest.mark.slow
def test_every_method_and_variant_answers_on_one_mass(tmp_path: Path) -> None:
    """All 25 methods and their variants; three rivals"""
    names = {*method_names(), *VARIANTS}
    names -= {name for name in method_names() if missing_package(name) is not None}
    found = results(f"-m method={','.join(sorted(names))} snr=40 replicates=1", tmp_path)
    assert {one["method"] for one in found if one["status"] not in ("ok", "unsupported")} <= {"nuts"}
    assert len(found) == len(names)


FAMILY = {"optimizer": 11, "weighting": 9, "architecture": 6, "uncertainty": 7}


@pytest.mark.parametrize("setting", FAMILY)
def test_the_pinn_family_has_its_choices(setting: str, tmp_path: Path) -> None:
    """the PINN family (11 optimisers, 9 weightings, 6 architectures, 7 uncertainties)"""
    from methods.pinn_family import PINNFamily

    choices = PINNFamily.card.choices[setting]
    assert len(choices) >= FAMILY[setting]
    error = run(f"method=pinn_family method.{setting}=no_such replicates=1", tmp_path, status=2).stderr
    assert all(name in error for name in choices)


@pytest.mark.slow
@pytest.mark.parametrize("setting", FAMILY)
def test_every_choice_of_the_pinn_family_trains(setting: str, tmp_path: Path) -> None:
    """the PINN family (11 optimisers, 9 weightings, 6 architectures, 7 uncertainties)"""
    from methods.pinn_family import PINNFamily

    choices = PINNFamily.card.choices[setting]
    line = f"-m method=pinn_family method.{setting}={','.join(choices)} method.budget=300 replicates=1"
    assert [one["status"] for one in results(line, tmp_path)] == ["ok"] * len(choices)


def test_trackers_and_windows(tmp_path: Path) -> None:
    """11 trackers and windows of batch methods"""
    assert len(entry_points(group="bench.trackers")) >= 11
    for method in ("rls", "window_shooting"):
        lines = run(f"track system=sdof method={method} forced=0", tmp_path, stdin=stream()).stdout
        assert last_value(lines, "k") == pytest.approx(8.0, rel=0.02)


def stream(n: int = 400) -> str:
    """Return lines of time (s), displacement (m) and force (N) of a mass of 1 kg with k = 8 N/m and c = 0.4 Ns/m."""
    rng = np.random.default_rng(2)
    x, v, lines = 1.0, 0.0, []
    for i in range(n):
        t = 0.05 * i
        force = 3 * np.sin(1.9 * t) + 2 * np.sin(3.3 * t)
        lines.append(f"{t:.2f},{x + rng.normal(0, 0.005):.5f},{force:.5f}")
        for _ in range(50):
            v += (force - 0.4 * v - 8.0 * x) * 0.001
            x += v * 0.001
    return "\n".join(lines) + "\n"


def last_value(lines: str, quantity: str) -> float:
    return float(json.loads(lines.splitlines()[-1])["quantities"][quantity]["value"])


# ---- systems and forces

QUICK_SYSTEMS = (
    *("chain2", "duffing", "sdof_forced", "sdof_sweep", "sdof_noise", "sdof_impulse", "sdof_step", "sdof_added_mass"),
    "sdof",
)


def bounds_by_system(systems: Sequence[str], folder: Path) -> dict[str, float]:
    """Return the bound of the mass's or first mass's error by system, where the scores have a finite bound."""
    line = f"-m method=prior system={','.join(systems)} prior=wide_mass replicates=1 workers=1"
    found = results(line, folder)
    assert all(np.isfinite(one["metrics"]["rmse"]["bound"]) for one in found)
    return {one["system"]: one["metrics"].get("m_error_pct", {}).get("bound", np.nan) for one in found}


def test_chains_nonlinear_systems_forces_and_an_added_mass(tmp_path: Path) -> None:
    """SDOF, chains, Duffing; multisine, sweep, noise, impulse, step; added mass"""
    bounds = bounds_by_system(QUICK_SYSTEMS, tmp_path)
    assert bounds.keys() == {*QUICK_SYSTEMS}
    assert bounds["sdof_added_mass"] < 0.5 * bounds["sdof"]  # a known mass tells the unknown one


@pytest.mark.slow
def test_every_system_of_the_configuration(tmp_path: Path) -> None:
    """Rayleigh, any matrices, Duffing, quadratic, Coulomb, van der Pol, pendulum, Bouc-Wen"""
    bounds_by_system([path.stem for path in (CONF / "system").glob("*.yaml")], tmp_path)


def test_a_chain_of_twenty_masses(tmp_path: Path) -> None:
    """chains to 20 masses"""
    numbers = range(1, 21)
    scenario = {
        "label": "chain20", "kind": "chain", "options": {"n": 20},
        "parameters": {f"{name}{i}": value for name, value in (("m", 1.0), ("c", 0.3), ("k", 20.0)) for i in numbers},
        "initial": {"displacement": [1.0] + [0.0] * 19, "velocity": [0.0] * 20},
        "duration": 20.0, "samples": 121, "force": None,
    }  # fmt: skip
    (tmp_path / "chain20.yaml").write_text(json.dumps(scenario))
    (one,) = results("method=prior system=chain20.yaml replicates=1 workers=1", tmp_path)
    assert np.isfinite(one["metrics"]["k20_error_pct"]["median"])


def test_disturbances(tmp_path: Path) -> None:
    """13 disturbances"""
    names = sorted(path.stem for path in (CONF / "disturbance").glob("*.yaml"))
    assert len(names) >= 13
    found = results(f"-m method=ls disturbance={','.join(names)} snr=40 replicates=1", tmp_path)
    errors = {one["disturbance"]: one["metrics"]["rmse"]["median"] for one in found}
    assert errors.keys() == {*names}
    assert len({f"{value:.5g}" for value in errors.values()}) >= len(names) - 1  # the error of an integrator is small


# ---- truth


def test_identifiability_the_share_of_the_prior_and_profiles(tmp_path: Path) -> None:
    """Bound, identifiability, prior share, profile likelihood"""
    text = run("identifiability system=chain2 snr=20 out=pictures", tmp_path).stdout
    assert "5 independent functions of the 6 parameters are identifiable" in text
    assert re.search(r"m1 .* decided by the prior", text)
    assert re.search(r"k2/m1 .* from the data", text)
    run("identifiability profile=true out=profiles", tmp_path)
    assert list((tmp_path / "profiles").glob("*.*"))


def test_the_calibration_and_robustness_of_published_cells() -> None:
    """calibration, SBC, paired comparisons and ties, gross errors, robustness, wrong models, the open split"""
    for name in ("calibration", "sbc", "leaderboard", "robustness", "misspecified", "open"):
        text = (REPOSITORY / "results" / f"{name}.md").read_text()
        assert text.count("\n|") > 5, name


def test_reproduction_of_the_paper(tmp_path: Path) -> None:
    """reproduction of the paper's 59 numbers"""
    paper = REPOSITORY / "claims" / "karkadakattil2026.yaml"
    assert len(json.loads(run(f"audit {paper} format=json", tmp_path).stdout)["findings"]) == 7 * 59
    with (REPOSITORY / "results" / "audits.csv").open() as file:
        verdicts = [row["replicates"] for row in csv.DictReader(file) if row["replicates"]]
    assert len(verdicts) == 59
    assert all(re.match("reproduced|ours|not decidable|incompatible|open", verdict) for verdict in verdicts)


# ---- results


def test_tables_of_a_store(folder: Path) -> None:
    """Tables 2-11 as md, csv, tex"""
    run("-m experiment=table3 method=prior", folder)
    run("tables archive=none out=mine tex=mine", folder)
    for ending in ("md", "csv", "tex"):
        assert (folder / "mine" / f"table3.{ending}").stat().st_size > 100
    assert re.search(r"prior.*\d+\.\d", (folder / "mine" / "table3.md").read_text())


@pytest.mark.slow
def test_tables_are_regenerated_byte_for_byte(tmp_path: Path) -> None:
    """all regenerated from the archive by one command each, byte for byte"""
    run(f"tables archive={ARCHIVE} out=.", tmp_path)
    written = {path.name for path in tmp_path.glob("*.*")}
    assert {f"table{i}.md" for i in range(2, 10)} | {"leaderboard.md"} <= written
    for name in sorted(written):
        published = REPOSITORY / "results" / name
        if published.exists():
            assert (tmp_path / name).read_bytes() == published.read_bytes(), name


@pytest.mark.slow
def test_figures_site_and_numbers_in_prose(tmp_path: Path) -> None:
    """figures of the paper (4-11) and ours; a site; every number in prose true by a check"""
    run(f"tables what=figures archive={ARCHIVE} out=figures", tmp_path)
    assert len(list((tmp_path / "figures").glob("*.png"))) >= 14
    run(f"report archive={ARCHIVE} out=site", tmp_path)
    index = (tmp_path / "site" / "index.html").read_text()
    assert "Multiple shooting" in index
    assert len(list((tmp_path / "site").rglob("*.html"))) > 30  # pages a method, system and scenario
    assert run("tables what=claims", REPOSITORY).stdout.count("\n") > 10


# ---- measured records

TRUE_RATIO = 9.0 + 0.1**2
"""k/m of the record (1/s²)."""


def write_formats(record: Path, folder: Path) -> Iterator[tuple[Path, dict[str, Any]]]:
    """Write a record in other formats; gives each file, and what it does not say of itself."""
    import pandas as pd
    from scipy.io import savemat

    times, millimetres = np.loadtxt(record, delimiter=",", skiprows=1).T
    frame = pd.DataFrame({"t [s]": times, "x [mm]": millimetres})
    frame.to_csv(folder / "german.csv", sep=";", decimal=",", index=False)
    yield folder / "german.csv", {}
    frame.to_parquet(folder / "r.parquet")
    yield folder / "r.parquet", {}
    if find_spec("openpyxl"):
        frame.to_excel(folder / "r.xlsx", index=False)
        yield folder / "r.xlsx", {}
    units = {"units": {"t": "s", "x": "mm"}}
    np.savez(folder / "r.npz", t=times, x=millimetres)
    yield folder / "r.npz", units
    savemat(folder / "r.mat", {"t": times, "x": millimetres})
    yield folder / "r.mat", units
    np.savetxt(folder / "bare.txt", millimetres)
    yield folder / "bare.txt", {"units": {"x": "mm"}, "rate": 89 / 12.0, "columns": {"x": 0}}


def test_formats_units_and_columns(record: Path, tmp_path: Path) -> None:
    """Formats, units, columns"""
    values = [
        bench.identify(path, method="matrix_pencil", **said).values["k_over_m"]
        for path, said in write_formats(record, tmp_path)
    ]
    assert values == pytest.approx([values[0]] * len(values), rel=1e-3)
    assert values[0] == pytest.approx(TRUE_RATIO, rel=0.02)


@pytest.mark.slow
def test_the_system_is_chosen(record: Path, tmp_path: Path) -> None:
    """``system=auto``"""
    text = run(f"method=shooting data={record} system=auto", tmp_path).stdout
    assert "auto selected system=" in text
    assert "k/m" in text


def test_fixed_parameters_priors_and_parts_of_a_record(record: Path) -> None:
    """fixed parameters, bounds, priors; decimate, detrend, from/to"""
    fixed = bench.identify(record, method="shooting", fixed={"m": 2.0})
    assert fixed.values["k"] == pytest.approx(2 * TRUE_RATIO, rel=0.03)
    prior = bench.identify(record, method="shooting", prior="nominal", nominal={"m": 1.0, "c": 0.5, "k": 9.0})
    assert prior.values["m"] == pytest.approx(1.0, rel=0.1)
    part = bench.identify(record, method="shooting", span=(0.5, 11.5), detrend=True)
    assert part.values["k_over_m"] == pytest.approx(TRUE_RATIO, rel=0.05)


def test_certificate(record: Path, tmp_path: Path) -> None:
    """intervals, verdict with reasons; certificate with classes, methods, replicas, what would help"""
    text = run(f"certify data={record} out=certificate method=shooting,ls system=sdof twins=5", tmp_path).stdout
    assert re.match("trust|use with caution", text)
    said = (tmp_path / "certificate" / "certificate.json").read_text()
    assert "k/m" in said or "k_over_m" in said
    assert "<html" in (tmp_path / "certificate" / "certificate.html").read_text()


def test_measured_track(tmp_path: Path) -> None:
    """the measured track"""
    run("-m experiment=measured set=mgh17 method=matrix_pencil,ls out=out", tmp_path)
    assert list((tmp_path / "out").glob("*.md"))


# ---- planning and streams

TEST = "design want=c_over_m:5% frequency=2 damping=0.02"


def test_design_of_a_test(tmp_path: Path) -> None:
    """``design`` (wanted error, optimal times)"""
    noise = "noise=0.5mm amplitude=1cm"
    assert re.search(r"\b42\b.*\b5\b", run(f"{TEST} {noise}", tmp_path).stdout)
    run(f"{TEST} {noise} samples=20 duration=5 times=optimal out=times.txt", tmp_path)
    assert len((tmp_path / "times.txt").read_text().split()) >= 20


def test_design_from_a_record(record: Path, tmp_path: Path) -> None:
    """``design`` (given record)"""
    assert "k/m" in run(f"design given={record} method=shooting", tmp_path).stdout


@pytest.mark.slow
def test_optimal_forces(tmp_path: Path) -> None:
    """``design`` (optimal forces)"""
    run(f"{TEST} noise=0.5mm samples=60 duration=10 force=optimal energy=10 mass=1 out=force.txt", tmp_path)
    assert (tmp_path / "force.txt").stat().st_size > 0


def test_what_to_expect_of_a_test(tmp_path: Path) -> None:
    """``expect``"""
    atlas = REPOSITORY / "results" / "atlas.csv.gz"
    assert "shooting" in run(f"design samples=50 cycles=5 damping=0.02 snr=20 atlas={atlas}", tmp_path).stdout


def test_the_atlas(tmp_path: Path) -> None:
    """the atlas (free and forced)"""
    run("-m experiment=atlas method=matrix_pencil part=points points=2 workers=1 out=out", tmp_path)
    assert list((tmp_path / "out").glob("atlas*"))
    text = run("-m experiment=atlas test=forced dry_run=true", tmp_path)
    assert re.search(r"[\d,]+ fits, \d+ tasks to do", text.stderr)


def test_track_a_stream_and_go_on_from_its_state(tmp_path: Path) -> None:
    """``track`` from standard input, file, with state"""
    lines = stream().splitlines(keepends=True)
    line = "track system=sdof method=rls forced=0 state=twin.state rate=20"
    first = run(line, tmp_path, stdin="".join(lines[:200])).stdout
    (tmp_path / "log.csv").write_text("".join(lines))
    second = run(f"{line} resume=true from=log.csv", tmp_path).stdout
    assert first.count("\n") == 200
    assert second.count("\n") == 200  # those of the first run are not counted twice
    assert last_value(second, "k") == pytest.approx(8.0, rel=0.2)


def test_track_in_the_terminal(tmp_path: Path) -> None:
    """``track`` with terminal"""
    shown = run("track system=sdof method=rls forced=0 view=true out=none", tmp_path, stdin=stream()).stderr
    assert re.search(r"k +[78]\.\d+ \[[78]\.\d+, [78]\.\d+\] N/m", shown)


def test_the_online_track(tmp_path: Path) -> None:
    """the online track with its bound"""
    run("-m experiment=online scenario=step10_multisine method=rls replicates=1 out=out workers=1", tmp_path)
    (table,) = (tmp_path / "out").glob("*.md")
    assert re.search(r"rls.*\d", table.read_text(), re.IGNORECASE)
