"""What a user can do, once each, by the command or call that they would type, on the smallest data that shows it.

Each test quotes the capability that it holds. Nothing here knows how a capability is made, so these tests stay while
the code below them changes.
"""

from __future__ import annotations

import contextlib
import csv
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import REPOSITORY

import bench

ARCHIVE = REPOSITORY / "results" / "archive"
METHODS = """
from dataclasses import dataclass
import gc, pathlib, time
import numpy as np
from bench import Card, Estimate, Identifier, Normal

CARD = Card("a method of the tests", "not used", "native", "simulated", "the prior's", "none")

@dataclass(frozen=True)
class Nominal(Identifier):
    seconds: float = 0.0
    log: str = ""
    card = CARD

    def estimate(self, problem, rng):
        if self.log:
            with pathlib.Path(self.log).open("a") as lines:
                lines.write("fit\\n")
        time.sleep(self.seconds)
        prior = problem.prior
        distribution = Normal(prior.names, prior.log_mean, np.diag(prior.log_sds**2), log=True)
        return Estimate(problem.system, parameters=distribution)

@dataclass(frozen=True)
class Hangs(Identifier):
    card = CARD

    def estimate(self, problem, rng):
        time.sleep(1e6)

@dataclass(frozen=True)
class Grows(Identifier):
    card = CARD

    def estimate(self, problem, rng):
        return np.ones(2**33).sum()

@dataclass(frozen=True)
class Raises(Identifier):
    card = CARD

    def estimate(self, problem, rng):
        raise ValueError("no idea")

@dataclass(frozen=True)
class Spies(Identifier):
    card = CARD

    def estimate(self, problem, rng):
        seed = getattr(rng.bit_generator, "seed_seq", None)
        known = [type(thing).__name__ for thing in gc.get_objects() if type(thing).__name__ in ("Truth", "Scenario")]
        raise ValueError(f"entropy {getattr(seed, 'entropy', None)} key {getattr(seed, 'spawn_key', ())} {known}")
"""
SYSTEM = """
from dataclasses import dataclass
from bench.systems.linear import SDOF

@dataclass(frozen=True)
class Rig(SDOF):
    pass
"""
OWN = ("nominal", "hangs", "grows", "raises", "spies")


def verb(name: str, *arguments: str) -> list[str]:
    """Return the command line of a verb."""
    return ["-m", "bench", name, *arguments]


def cells(*arguments: str) -> list[str]:
    """Return the command line that computes cells."""
    return ["-m", "bench", *arguments]


def environment() -> dict[str, str]:
    """Return that of a user's shell, with the own methods of :data:`METHODS` installed where they are."""
    return {**os.environ, "PYTHONDONTWRITEBYTECODE": "1", "COLUMNS": "200"}


def run(command: Sequence[str], folder: Path, status: int = 0, stdin: str = "", **more: str) -> Any:
    """Run Python with a command line in a folder, and check its exit status."""
    done = subprocess.run(
        [sys.executable, *command], cwd=folder, env={**environment(), **more}, input=stdin,
        capture_output=True, text=True, timeout=900,
    )  # fmt: skip
    assert done.returncode == status, (command, done.stdout[-2000:], done.stderr[-2000:])
    return done


def results(command: Sequence[str], folder: Path, **more: str) -> list[dict[str, Any]]:
    """Run cells with ``format=json`` and return one result a cell."""
    lines = run([*command, "format=json"], folder, **more).stdout.splitlines()
    return [json.loads(line) for line in lines]


def stored(folder: Path) -> list[str]:
    """Return what names the finished cells of a store."""
    return sorted(path.stem for path in folder.glob("*.*") if re.fullmatch(r"[0-9a-f]{20}", path.stem))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that a user works in, whose store ``outputs/rows`` has six small cells."""
    folder = tmp_path_factory.mktemp("user")
    run(cells("-m", "method=ls,oracle,shooting", "snr=20,40", "replicates=3", "workers=1"), folder)
    return folder


@pytest.fixture(scope="module")
def packages(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A folder of installed packages with methods and a system of the user's own."""
    folder = tmp_path_factory.mktemp("packages")
    (folder / "own_methods.py").write_text(METHODS)
    (folder / "own_system.py").write_text(SYSTEM)
    metadata = folder / "own_methods-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: own-methods\nVersion: 1.0\n")
    points = "".join(f"{name} = own_methods:{name.title()}\n" for name in OWN)
    (metadata / "entry_points.txt").write_text(f"[bench.methods]\n{points}[bench.systems]\nrig = own_system:Rig\n")
    return str(folder)


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
    text = run(cells("method=pinn", "snr=10", "replicates=1", "workers=1"), folder).stdout
    assert "pinn on sdof, 10 dB" in text
    assert re.search(r"k/m %\s+\d", text)
    assert "bound" in text


def test_a_sweep(tmp_path: Path) -> None:
    """``-m method=... snr=... system=... seed=range(...)``"""
    found = results(
        cells("-m", "method=prior,oracle", "snr=20,40", "system=sdof,sdof_heavy", "seed=range(0,2)", "replicates=1"),
        tmp_path,
    )
    assert len({one["cell"] for one in found}) == 2 * 2 * 2 * 2
    assert {(one["system"], one["snr"], one["seed"]) for one in found} >= {("sdof", 20.0, 0), ("sdof_heavy", 40.0, 1)}


def test_every_experiment_is_a_list_of_cells() -> None:
    """every experiment of ``conf/experiment``"""
    for path in (REPOSITORY / "conf" / "experiment").glob("*.yaml"):
        assert len(bench.experiment(path.stem)) > 1, path.stem


def test_the_cells_of_an_experiment_are_run(tmp_path: Path) -> None:
    """every experiment of ``conf/experiment``"""
    found = results(cells("-m", "experiment=table3", "method=prior", "replicates=1", "workers=1"), tmp_path)
    assert {(one["method"], one["initial_state"]) for one in found} == {("prior", "known"), ("prior", "unknown")}


def test_fields_of_scenario_prior_disturbance_and_method(tmp_path: Path) -> None:
    """fields of scenario, prior, disturbance, method settings"""
    (plain,) = results(cells("method=ls", "replicates=1"), tmp_path)
    (other,) = results(
        cells("method=ls", "replicates=1", "system.samples=60", "system.parameters.c=0.8", "prior=wide_mass",
              "disturbance=outliers", "disturbance.size=20", "method.derivative=spline"), tmp_path,
    )  # fmt: skip
    assert (other["prior"], other["disturbance"]) == ("wide_mass", "outliers")
    assert other["cell"] != plain["cell"]
    bounds = [one["metrics"]["c_over_m_error_pct"]["bound"] for one in (plain, other)]
    assert bounds[1] < bounds[0]  # more samples of a more damped motion


def test_own_methods_systems_and_scenario_files(packages: str, tmp_path: Path) -> None:
    """own system, method and scenario files and entry points"""
    text = (REPOSITORY / "conf" / "system" / "sdof.yaml").read_text()
    (tmp_path / "my_rig.yaml").write_text(
        text.replace("kind: sdof", "kind: rig").replace("label: sdof", "label: my rig")
    )
    (one,) = results(cells("method=nominal", "system=my_rig.yaml", "replicates=1"), tmp_path, PYTHONPATH=packages)
    assert (one["method"], one["system"], one["n_ok"]) == ("nominal", "my rig", 1)


def test_limits_and_failures_are_rows(packages: str, tmp_path: Path) -> None:
    """limits of time and memory a fit, failed replicates as rows with a status"""
    found = results(
        cells("-m", "method=hangs,grows,raises,nominal", "replicates=1", "timeout_s=1", "memory_mb=1000"),
        tmp_path, PYTHONPATH=packages,
    )  # fmt: skip
    statuses = {one["method"]: one["status"] for one in found}
    assert statuses == {"hangs": "timeout", "grows": "oom", "raises": "crashed", "nominal": "ok"}


def start_slow_sweep(packages: str, folder: Path, log: Path) -> subprocess.Popen[bytes]:
    """Start a sweep of six cells of two slow fits each that write a line a fit."""
    command = slow_sweep(log)
    return subprocess.Popen(
        [sys.executable, *command], cwd=folder, env={**environment(), "PYTHONPATH": packages},
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
    )  # fmt: skip


def slow_sweep(log: Path) -> list[str]:
    return cells(
        "-m", "method=nominal", "method.seconds=0.2", f"method.log={log}", "seed=range(0,6)", "replicates=2",
        "workers=1", "store=rows",
    )  # fmt: skip


def wait_for_cells(folder: Path, n: int) -> None:
    deadline = time.monotonic() + 120
    while len(stored(folder)) < n and time.monotonic() < deadline:
        time.sleep(0.02)


def test_resume_after_kill_9(packages: str, tmp_path: Path) -> None:
    """resume after kill -9 without a lost or doubled cell"""
    log = tmp_path / "log"
    sweep = start_slow_sweep(packages, tmp_path, log)
    wait_for_cells(tmp_path / "rows", 2)
    os.kill(sweep.pid, signal.SIGKILL)
    sweep.wait()
    before = {
        name: [p.stat().st_mtime_ns for p in (tmp_path / "rows").glob(f"{name}.*")]
        for name in stored(tmp_path / "rows")
    }
    assert 2 <= len(before) < 6
    found = results(slow_sweep(log), tmp_path, PYTHONPATH=packages)
    assert [one["n_ok"] for one in found] == [2] * 6
    after = stored(tmp_path / "rows")
    assert len(set(after)) == 6
    for name, stamps in before.items():
        assert [p.stat().st_mtime_ns for p in (tmp_path / "rows").glob(f"{name}.*")] == stamps


def test_two_drivers_on_one_store(packages: str, tmp_path: Path) -> None:
    """two drivers on one store"""
    log = tmp_path / "log"
    drivers = [start_slow_sweep(packages, tmp_path, log) for _ in range(2)]
    assert [driver.wait(timeout=200) for driver in drivers] == [0, 0]
    assert len(stored(tmp_path / "rows")) == 6
    assert len(log.read_text().splitlines()) == 12  # no fit twice


def test_ctrl_c_keeps_finished_cells(packages: str, tmp_path: Path) -> None:
    """Ctrl-C keeps finished cells"""
    sweep = start_slow_sweep(packages, tmp_path, tmp_path / "log")
    wait_for_cells(tmp_path / "rows", 1)
    os.kill(sweep.pid, signal.SIGINT)
    assert sweep.wait(timeout=60) == 130
    kept = stored(tmp_path / "rows")
    assert 1 <= len(kept) < 6
    assert not list((tmp_path / "rows").glob("*.tmp"))


@pytest.mark.slow
@pytest.mark.skipif(find_spec("ray") is None, reason="Ray is not installed")
def test_ray(tmp_path: Path) -> None:
    """Ray and Slurm"""
    found = results(
        cells("-m", "method=prior,oracle", "replicates=2", "cells_per_job=1", "hydra/launcher=ray"), tmp_path
    )
    assert [one["n_ok"] for one in found] == [2, 2]


@pytest.mark.slow
@pytest.mark.skipif(find_spec("submitit") is None, reason="submitit is not installed")
def test_jobs_as_slurm_runs_them(tmp_path: Path) -> None:
    """Ray and Slurm; Slurm's daemons are tried by ``tests.studies.sweeps``"""
    more = {"XDG_CACHE_HOME": str(tmp_path / "cache")}
    line = cells("-m", "method=prior,oracle", "replicates=2", "cells_per_job=1", "hydra/launcher=submitit_local")
    found = results(line, tmp_path, **more)
    assert [one["n_ok"] for one in found] == [2, 2]


def test_progress_with_time_left(packages: str, tmp_path: Path) -> None:
    """progress with time left; in a terminal"""
    line = cells("-m", "method=nominal", "method.seconds=0.2", "snr=20,30", "replicates=10", "workers=1")
    screen, terminal = os.openpty()
    sweep = subprocess.Popen(
        [sys.executable, *line], cwd=tmp_path, env={**environment(), "PYTHONPATH": packages},
        stdin=terminal, stdout=subprocess.DEVNULL, stderr=terminal,
    )  # fmt: skip
    os.close(terminal)
    shown = b""
    with contextlib.suppress(OSError):  # the terminal's other end is closed
        while piece := os.read(screen, 4096):
            shown += piece
    os.close(screen)
    assert sweep.wait() == 0
    assert re.search(r"[1-9]/20 fits", shown.decode())
    assert "left" in shown.decode()


def test_status_of_a_store_and_of_a_sweep(folder: Path) -> None:
    """``status``"""
    text = run(verb("status", "method=ls,rls", "snr=20", "replicates=3"), folder).stdout
    assert re.search(r"ls +sdof 20 dB known +3 +done", text)
    assert re.search(r"rls +sdof 20 dB known +3 +missing", text)
    assert re.search(r"\d+ cells: \d+ done", run(verb("status"), folder).stdout)


def test_reproduce(folder: Path) -> None:
    """``reproduce <id>``"""
    (name,) = {one["cell"] for one in results(cells("method=ls", "snr=20", "replicates=3"), folder)}
    text = run(verb("reproduce", f"cell={name}"), folder).stdout
    assert re.search("identical|within tolerance", text)


def test_store_and_archive_are_read_together(tmp_path: Path) -> None:
    """store and archive read together"""
    line = cells("-m", "experiment=table3", "method=prior", "dry_run=true")
    assert "2 cells: 2 missing" in run([*line, "archive=none"], tmp_path).stdout
    assert re.search("2 cells: 2 (done|stale)", run([*line, f"archive={ARCHIVE}"], tmp_path).stdout)


def test_json_output(folder: Path) -> None:
    """JSON output"""
    (one,) = results(cells("method=oracle", "snr=20", "replicates=3"), folder)
    metric = one["metrics"]["k_over_m_error_pct"]
    assert 0.1 < metric["median"] / metric["bound"] < 10
    assert one["n_ok"] == one["replicates"] == 3


def test_hydra_habits(tmp_path: Path) -> None:
    """the Hydra habits people have: ``--cfg job``, ``--help``, ``+experiment=``, shell completion"""
    assert "snr" in run(cells("method=pinn", "snr=10", "--cfg", "job"), tmp_path).stdout
    assert "method" in run(cells("--help"), tmp_path).stdout
    line = cells("-m", "+experiment=table3", "method=prior", "dry_run=true")
    assert "prior" in run(line, tmp_path).stdout
    assert "complete" in run(cells("--shell-completion", "install=bash"), tmp_path).stdout


# ---- methods


def test_methods_are_as_many_as_before() -> None:
    """All 25 methods and their variants"""
    from bench.entrants.registry import method_names

    variants = {path.stem for path in (REPOSITORY / "conf" / "method").glob("*.yaml")}
    assert len(set(method_names()) - {"prior", "oracle"}) >= 25
    assert len(variants - set(method_names())) >= 13


QUICK_METHODS = ("ar", "ar_recursive", "ekf", "era", "frequency", "iqml", "log_decrement", "ls", "matrix_pencil", "rls")


def test_quick_methods_answer_on_one_mass(tmp_path: Path) -> None:
    """All methods on all systems they serve"""
    line = cells("-m", f"method={','.join(QUICK_METHODS)}", "snr=40", "replicates=1", "initial_state=unknown")
    found = results(line, tmp_path)
    assert {one["method"]: one["status"] for one in found} == dict.fromkeys(QUICK_METHODS, "ok")
    errors = [one["metrics"]["k_over_m_error_pct"]["median"] for one in found]
    assert sorted(errors)[len(errors) // 2] < 2.0


@pytest.mark.slow
def test_every_method_and_variant_answers_on_one_mass(tmp_path: Path) -> None:
    """All 25 methods and their variants"""
    from bench.entrants.registry import method_names, missing_package

    names = [name for name in method_names() if missing_package(name) is None]
    names += [path.stem for path in (REPOSITORY / "conf" / "method").glob("*.yaml") if path.stem not in names]
    found = results(cells("-m", f"method={','.join(names)}", "snr=40", "replicates=1"), tmp_path)
    assert {one["method"] for one in found if one["status"] not in ("ok", "unsupported")} <= {"nuts"}
    assert len(found) == len(names)


def test_alone_and_in_batches_the_numbers_are_the_same() -> None:
    """alone and in batches, with the same numbers"""
    from bench.scenario.scenario import PriorSpec, Scenario
    from methods.trajectory.shooting import Shooting

    prior = PriorSpec("nominal", {"mass": 0.02, "damping": 1.0, "stiffness": 0.5, "other": 0.5})
    scenario = Scenario("sdof", {"m": 1.0, "c": 0.4, "k": 8.0}, ((1.0,), (0.0,)), 20.0, prior=prior)
    problems = [problem for problem, _ in scenario.replicates(0, 3)]

    def streams() -> list[np.random.Generator]:
        return [np.random.default_rng(i) for i in range(3)]

    batch = Shooting().identify_many(problems, streams())
    alone = [Shooting().identify(problem, rng) for problem, rng in zip(problems, streams(), strict=True)]
    for one, other in zip(alone, batch, strict=True):
        assert one.parameters is not None
        assert other.parameters is not None
        assert one.parameters.mean == pytest.approx(other.parameters.mean, rel=1e-9)


FAMILY = {"optimizer": 11, "weighting": 9, "architecture": 6, "uncertainty": 7}


@pytest.mark.parametrize("setting", FAMILY)
def test_the_pinn_family_has_its_choices(setting: str, tmp_path: Path) -> None:
    """the PINN family (11 optimisers, 9 weightings, 6 architectures, 7 uncertainties)"""
    from methods.pinn_family import PINNFamily

    assert len(PINNFamily.card.choices[setting]) >= FAMILY[setting]
    line = cells("method=pinn_family", f"method.{setting}=no_such", "replicates=1")
    error = run(line, tmp_path, status=2).stderr
    assert all(name in error for name in PINNFamily.card.choices[setting])


@pytest.mark.slow
@pytest.mark.parametrize("setting", FAMILY)
def test_every_choice_of_the_pinn_family_trains(setting: str, tmp_path: Path) -> None:
    """the PINN family (11 optimisers, 9 weightings, 6 architectures, 7 uncertainties)"""
    from methods.pinn_family import PINNFamily

    choices = ",".join(PINNFamily.card.choices[setting])
    line = cells("-m", "method=pinn_family", f"method.{setting}={choices}", "method.budget=300", "replicates=1")
    found = results(line, tmp_path)
    assert [one["status"] for one in found] == ["ok"] * len(PINNFamily.card.choices[setting])


@pytest.mark.slow
@pytest.mark.parametrize(("rival", "package"), [("deepxde", "deepxde"), ("jinns", "jinns"), ("pina", "pina")])
def test_rivals(rival: str, package: str, tmp_path: Path) -> None:
    """three rivals"""
    pytest.importorskip(package)
    (one,) = results(cells(f"method=rival_{rival}", "replicates=1"), tmp_path)
    assert one["status"] == "ok"


def test_trackers_and_windows(tmp_path: Path) -> None:
    """11 trackers and windows of batch methods"""
    from importlib.metadata import entry_points

    assert len(entry_points(group="bench.trackers")) >= 11
    for method in ("rls", "window_shooting"):
        lines = run(verb("track", "system=sdof", f"method={method}", "forced=0"), tmp_path, stdin=stream()).stdout
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

SYSTEMS = ("chain2", "duffing")
FORCES = ("sdof_forced", "sdof_sweep", "sdof_noise", "sdof_impulse", "sdof_step")


def bounds_by_system(systems: Sequence[str], folder: Path) -> dict[str, bool]:
    """Return of each system whether its nominal values were scored beside a finite bound."""
    line = cells("-m", "method=prior", f"system={','.join(systems)}", "replicates=1", "workers=1")
    found = results(line, folder)
    return {one["system"]: np.isfinite(one["metrics"]["rmse"]["bound"]) for one in found}


def test_chains_and_nonlinear_systems(tmp_path: Path) -> None:
    """SDOF, chains, Duffing"""
    assert bounds_by_system(SYSTEMS, tmp_path) == dict.fromkeys(SYSTEMS, True)


@pytest.mark.slow
def test_every_system_of_the_configuration(tmp_path: Path) -> None:
    """Rayleigh, any matrices, Duffing, quadratic, Coulomb, van der Pol, pendulum, Bouc-Wen"""
    names = [path.stem for path in (REPOSITORY / "conf" / "system").glob("*.yaml")]
    assert all(bounds_by_system(names, tmp_path).values())


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
    (one,) = results(cells("method=prior", "system=chain20.yaml", "replicates=1", "workers=1"), tmp_path)
    assert np.isfinite(one["metrics"]["k20_error_pct"]["median"])


def test_sums_of_terms(record: Path) -> None:
    """sums"""
    answer = bench.identify(record, method="shooting", system="sdof+coulomb")
    assert {"k_over_m", "mu_over_m"} <= answer.values.keys()


def test_forces(tmp_path: Path) -> None:
    """multisine, sweep, noise, impulse, step"""
    assert bounds_by_system(FORCES, tmp_path) == dict.fromkeys(FORCES, True)


def test_added_mass(tmp_path: Path) -> None:
    """added mass"""
    found = results(
        cells("-m", "method=prior", "system=sdof,sdof_added_mass", "prior=wide_mass", "replicates=1"), tmp_path
    )
    bounds = {one["system"]: one["metrics"]["m_error_pct"]["bound"] for one in found}
    assert bounds["sdof_added_mass"] < 0.5 * bounds["sdof"]  # a known mass tells the unknown one


def test_disturbances(tmp_path: Path) -> None:
    """13 disturbances"""
    names = sorted(path.stem for path in (REPOSITORY / "conf" / "disturbance").glob("*.yaml"))
    assert len(names) >= 13
    found = results(cells("-m", "method=ls", f"disturbance={','.join(names)}", "snr=40", "replicates=1"), tmp_path)
    errors = {one["disturbance"]: one["metrics"]["rmse"]["median"] for one in found}
    assert errors.keys() == {*names}
    assert len({f"{value:.5g}" for value in errors.values()}) >= len(names) - 1  # the error of an integrator is small


# ---- truth


def test_identifiability_and_the_share_of_the_prior(tmp_path: Path) -> None:
    """Bound, identifiability, prior share"""
    text = run(verb("identifiability", "system=chain2", "snr=20", "out=pictures"), tmp_path).stdout
    assert "5 independent functions of the 6 parameters are identifiable" in text
    assert re.search(r"m1 .* decided by the prior", text)
    assert re.search(r"k2/m1 .* from the data", text)


def test_profile_likelihood(tmp_path: Path) -> None:
    """profile likelihood"""
    run(verb("identifiability", "profile=true", "out=pictures"), tmp_path)
    assert list((tmp_path / "pictures").glob("*.*"))


def test_the_calibration_and_robustness_of_published_cells() -> None:
    """calibration, SBC, paired comparisons and ties, gross errors, robustness, wrong models, the open split"""
    for name in ("calibration", "sbc", "leaderboard", "robustness", "misspecified", "open"):
        text = (REPOSITORY / "results" / f"{name}.md").read_text()
        assert text.count("\n|") > 5, name


def test_reproduction_of_the_paper(tmp_path: Path) -> None:
    """reproduction of the paper's 59 numbers"""
    paper = REPOSITORY / "claims" / "karkadakattil2026.yaml"
    assert len(json.loads(run(verb("audit", str(paper), "format=json"), tmp_path).stdout)["findings"]) == 7 * 59
    with (REPOSITORY / "results" / "audits.csv").open() as file:
        verdicts = [row["replicates"] for row in csv.DictReader(file) if row["replicates"]]
    assert len(verdicts) == 59
    assert all(re.match("reproduced|ours|not decidable|incompatible|open", verdict) for verdict in verdicts)


# ---- results


def test_tables_of_a_store(folder: Path) -> None:
    """Tables 2-11 as md, csv, tex"""
    run(cells("-m", "experiment=table3", "method=prior"), folder)
    run(verb("tables", "archive=none", "out=mine", "tex=mine"), folder)
    for ending in ("md", "csv", "tex"):
        assert (folder / "mine" / f"table3.{ending}").stat().st_size > 100
    assert re.search(r"prior.*\d+\.\d", (folder / "mine" / "table3.md").read_text())


@pytest.mark.slow
def test_tables_are_regenerated_byte_for_byte(tmp_path: Path) -> None:
    """all regenerated from the archive by one command each, byte for byte"""
    run(verb("tables", f"archive={ARCHIVE}", "out=."), tmp_path)
    written = {path.name for path in tmp_path.glob("*.*")}
    assert {f"table{i}.md" for i in range(2, 10)} | {"leaderboard.md"} <= written
    for name in sorted(written):
        published = REPOSITORY / "results" / name
        if published.exists():
            assert (tmp_path / name).read_bytes() == published.read_bytes(), name


@pytest.mark.slow
def test_figures_and_site(tmp_path: Path) -> None:
    """figures of the paper (4-11) and ours; a site"""
    run(verb("tables", "what=figures", f"archive={ARCHIVE}", "out=figures"), tmp_path)
    assert len(list((tmp_path / "figures").glob("*.png"))) >= 14
    run(verb("report", f"archive={ARCHIVE}", "out=site"), tmp_path)
    index = (tmp_path / "site" / "index.html").read_text()
    assert "Multiple shooting" in index
    assert len(list((tmp_path / "site").rglob("*.html"))) > 30  # pages a method, system and scenario


@pytest.mark.slow
def test_every_number_in_prose_is_checked(tmp_path: Path) -> None:
    """every number in prose true by a check"""
    text = run(verb("tables", "what=claims"), REPOSITORY).stdout
    assert text.count("\n") > 10


# ---- measured records

TRUE_RATIO = 9.0 + 0.1**2
"""k/m of the record (1/s²)."""


def columns(record: Path) -> tuple[np.ndarray, np.ndarray]:
    times, millimetres = np.loadtxt(record, delimiter=",", skiprows=1).T
    return times, millimetres


def write_formats(record: Path, folder: Path) -> Iterator[tuple[Path, dict[str, Any]]]:
    """Write a record in other formats; gives each file, and what it does not say of itself."""
    import pandas as pd
    from scipy.io import savemat

    times, millimetres = columns(record)
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


def test_several_files_of_one_rig(record: Path, tmp_path: Path) -> None:
    """several files and channels"""
    second = tmp_path / "second.csv"
    write_decay(second, 6)
    answer = bench.identify([record, second], method="shooting")
    low, high = answer.intervals["k_over_m"]
    assert low < TRUE_RATIO < high


@pytest.mark.slow
def test_the_system_is_chosen(record: Path, tmp_path: Path) -> None:
    """``system=auto``"""
    line = cells("method=shooting", f"data={record}", "system=auto")
    text = run(line, tmp_path).stdout
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
    line = verb("certify", f"data={record}", "out=certificate", "method=shooting,ls", "system=sdof", "twins=5")
    text = run(line, tmp_path).stdout
    assert re.match("trust|use with caution", text)
    said = json.loads((tmp_path / "certificate" / "certificate.json").read_text())
    assert "k/m" in json.dumps(said) or "k_over_m" in json.dumps(said)
    assert "<html" in (tmp_path / "certificate" / "certificate.html").read_text()


def test_measured_track(tmp_path: Path) -> None:
    """the measured track"""
    run(cells("-m", "experiment=measured", "set=mgh17", "method=matrix_pencil,ls", "out=out"), tmp_path)
    assert list((tmp_path / "out").glob("*.md"))


# ---- planning and streams

TEST = ("want=c_over_m:5%", "frequency=2", "damping=0.02", "noise=0.5mm", "amplitude=1cm")


def test_design_of_a_test(tmp_path: Path) -> None:
    """``design`` (wanted error)"""
    assert re.search(r"\b42\b.*\b5\b", run(verb("design", *TEST), tmp_path).stdout)


def test_design_from_a_record(record: Path, tmp_path: Path) -> None:
    """``design`` (given record)"""
    text = run(verb("design", f"given={record}", "method=shooting"), tmp_path).stdout
    assert "k/m" in text


def test_optimal_times(tmp_path: Path) -> None:
    """``design`` (optimal times)"""
    given = ("samples=20", "duration=5", "times=optimal", "out=times.txt")
    run(verb("design", *TEST, *given), tmp_path)
    assert len((tmp_path / "times.txt").read_text().split()) >= 20


@pytest.mark.slow
def test_optimal_forces(tmp_path: Path) -> None:
    """``design`` (optimal forces)"""
    given = ("samples=60", "duration=10", "force=optimal", "energy=10", "mass=1", "out=force.txt")
    run(verb("design", *TEST[:-1], *given), tmp_path)
    assert (tmp_path / "force.txt").stat().st_size > 0


def test_what_to_expect_of_a_test(tmp_path: Path) -> None:
    """``expect``"""
    atlas = f"atlas={REPOSITORY / 'results' / 'atlas.csv.gz'}"
    text = run(verb("design", "samples=50", "cycles=5", "damping=0.02", "snr=20", atlas), tmp_path).stdout
    assert re.search("shooting", text)


def test_the_atlas(tmp_path: Path) -> None:
    """the atlas (free)"""
    line = ("experiment=atlas", "method=matrix_pencil", "part=points", "points=2", "workers=1", "out=out")
    run(cells("-m", *line), tmp_path)
    assert list((tmp_path / "out").glob("atlas*"))


@pytest.mark.slow
def test_the_forced_atlas(tmp_path: Path) -> None:
    """the atlas (forced)"""
    text = run(cells("-m", "experiment=atlas", "test=forced", "dry_run=true"), tmp_path)
    assert re.search(r"[\d,]+ fits, \d+ tasks to do", text.stderr)


def test_track_a_stream_and_go_on_from_its_state(tmp_path: Path) -> None:
    """``track`` from standard input, file, with state"""
    lines = stream().splitlines(keepends=True)
    common = verb("track", "system=sdof", "method=rls", "forced=0", "state=twin.state", "rate=20")
    first = run(common, tmp_path, stdin="".join(lines[:200])).stdout
    (tmp_path / "log.csv").write_text("".join(lines))
    second = run([*common, "resume=true", "from=log.csv"], tmp_path).stdout
    assert first.count("\n") == 200
    assert second.count("\n") == 200  # those of the first run are not counted twice
    assert last_value(second, "k") == pytest.approx(8.0, rel=0.2)


def test_track_in_the_terminal(tmp_path: Path) -> None:
    """``track`` with terminal"""
    line = verb("track", "system=sdof", "method=rls", "forced=0", "view=true", "out=none")
    shown = run(line, tmp_path, stdin=stream()).stderr
    assert re.search(r"k +[78]\.\d+ \[[78]\.\d+, [78]\.\d+\] N/m", shown)


def test_the_online_track(tmp_path: Path) -> None:
    """the online track with its bound"""
    line = ("experiment=online", "scenario=step10_multisine", "method=rls", "replicates=1", "out=out", "workers=1")
    run(cells("-m", *line), tmp_path)
    (table,) = (tmp_path / "out").glob("*.md")
    assert re.search(r"rls.*\d", table.read_text(), re.IGNORECASE)


# ---- kit


@pytest.mark.parametrize("kind", ["method", "system"])
def test_a_new_package_passes_its_checks(kind: str, tmp_path: Path) -> None:
    """check, new (method, system)"""
    run(verb("new", f"{kind}=my_thing"), tmp_path)
    (package,) = tmp_path.glob("*")
    text = run(verb("check", f"package={package}"), tmp_path).stdout
    assert re.search(r"(\d+) of \1 checks passed", text)


def test_submit_and_merge(folder: Path, tmp_path: Path) -> None:
    """submit, merge"""
    run(verb("share", "action=submit", "method=ls", "by=a test", f"out={tmp_path / 'ls.submission'}"), folder)
    run(verb("share", "action=merge", "submission=ls.submission", "store=theirs", "workers=1", "fresh=4"), tmp_path)
    assert len(stored(tmp_path / "theirs")) == 2


def test_merge_of_two_stores(folder: Path, tmp_path: Path) -> None:
    """merge"""
    run(verb("share", "action=merge", f"submission={folder / 'outputs' / 'rows'}", "store=theirs"), tmp_path)
    assert stored(tmp_path / "theirs") == stored(folder / "outputs" / "rows")


@pytest.mark.parametrize(
    ("kind", "package", "arguments"),
    [
        ("petab", "libsbml", ("system=sdof", "snr=20", "out=petab")),
        ("notebook", "nbformat", ("method=ls", "snr=20", "out=cell.ipynb")),
        ("arviz", "arviz", ("out=draws.nc",)),
    ],
)
def test_export(kind: str, package: str, arguments: tuple[str, ...], folder: Path) -> None:
    """export (PEtab, ArviZ, notebook)"""
    pytest.importorskip(package)
    more = arguments
    if kind == "arviz":
        (one,) = results(cells("method=mcmc", "snr=20", "replicates=1"), folder)
        more = (f"cell={one['cell']}", *arguments)
    run(verb("share", "action=export", f"form={kind}", *more), folder)
    assert (folder / arguments[-1].removeprefix("out=")).exists()


# ---- Python


def test_run_identify_experiment_from_python(record: Path, tmp_path: Path) -> None:
    """``bench.run``, ``bench.identify``, ``bench.experiment``, typed"""
    table = bench.run(method=["prior", "oracle"], snr=20, replicates=2, workers=1, store=tmp_path / "rows").frame()
    assert set(table.method) == {"prior", "oracle"}
    low, high = bench.identify(record, method="shooting").intervals["k_over_m"]
    assert low < TRUE_RATIO < high
    assert len(bench.experiment("table3", method="ls")) == 2
    assert (Path(bench.__file__).parent / "py.typed").exists()


# ---- bad input, stores, honesty


@pytest.mark.parametrize(
    ("command", "names"),
    [
        (cells("method=pin"), ("method", "pin", "pinn")),
        (cells("method=ls", "snr=loud"), ("snr", "loud")),
        (cells("method=ls", "data=no_such.csv"), ("data", "no_such.csv")),
        (verb("design", "want=c_over_m:5%", "frequency=-2", "damping=0.02", "noise=1mm"), ("frequency", "-2")),
        (verb("tables", "store=no_such", "archive=none"), ("store", "no_such")),
    ],
)
def test_bad_input_is_one_line(command: list[str], names: tuple[str, ...], tmp_path: Path) -> None:
    """**Bad input**: one line, exit status 2, before any work"""
    done = run(command, tmp_path, status=2)
    assert done.stdout == ""
    assert len(done.stderr.splitlines()) == 1
    assert all(name in done.stderr for name in names)
    assert not list(tmp_path.iterdir())


def test_damage_of_a_store_is_noticed(tmp_path: Path) -> None:
    """**A store is data**: nothing in it executes; damage is noticed"""
    line = cells("method=prior", "replicates=2", "workers=1", "store=rows")
    run(line, tmp_path)
    (name,) = stored(tmp_path / "rows")
    (path,) = [path for path in (tmp_path / "rows").glob(f"{name}.*") if path.suffix in (".json", ".parquet")]
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 4
    path.write_bytes(content)
    assert name in run(line, tmp_path, status=2).stderr


def test_no_truth_reaches_a_method(packages: str, tmp_path: Path) -> None:
    """**No truth reaches a method.**"""
    (one,) = results(cells("method=spies", "replicates=1", "seed=12345"), tmp_path, PYTHONPATH=packages)
    assert one["status"] == "crashed"
    assert "entropy" in one["message"]
    assert "12345" not in one["message"]
    assert one["message"].endswith("[]")
