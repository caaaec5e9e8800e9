"""The wheel, built and run from an empty folder, works like the checkout; wheel and sdist are fit to be published."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tarfile
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from conftest import REPOSITORY

pytest.importorskip("build")
pytest.importorskip("hatchling")

PARTS = ("bench", "methods", "conf", "pyproject.toml", "README.md", "LICENSE")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A wheel built from a copy of the checkout, so that nothing is written into it."""
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"
    source.mkdir()
    for part in PARTS:
        if (REPOSITORY / part).is_dir():
            shutil.copytree(REPOSITORY / part, source / part, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(REPOSITORY / part, source / part)
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", "dist", "source"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder)
    assert done.returncode == 0, done.stderr
    (path,) = (folder / "dist").glob("*.whl")
    return path


@pytest.fixture(scope="module")
def site(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel installed into a folder of its own."""
    target = tmp_path_factory.mktemp("installed") / "site"
    command = [sys.executable, "-m", "pip", "install", "--no-deps", "--no-index", "--quiet", "--target", str(target)]
    done = subprocess.run([*command, str(wheel)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return target


def test_every_module_and_every_data_file_is_in_the_wheel_and_no_test(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    for folder in ("bench", "methods", "conf"):
        for path in (REPOSITORY / folder).rglob("*"):
            if path.is_file() and path.suffix != ".pyc":
                assert str(path.relative_to(REPOSITORY)) in names
    assert not [name for name in names if name.startswith(("tests", "results"))]
    text = next(name for name in names if name.endswith("entry_points.txt"))
    points = zipfile.ZipFile(wheel).read(text).decode()
    assert "[bench.methods]" in points
    assert "ls = methods.regression.ls:LS" in points
    assert "vibration-bench = bench.commands.main:main" in points


@pytest.mark.slow
def test_an_installed_wheel_runs_from_an_empty_folder(site: Path, python: Callable[..., Any]) -> None:
    env = {"PYTHONPATH": str(site)}
    done = python("-m", "bench", "method=oracle", "replicates=2", "format=json", "workers=1", "store=rows", env=env)
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert (result["method"], result["n_ok"], result["status"]) == ("oracle", 2, "ok")
    assert result["metrics"]["rmse"]["bound"] == pytest.approx(0.0107, abs=5e-5)


@pytest.mark.slow
def test_wheel_and_sdist_are_fit_to_be_published(tmp_path: Path) -> None:
    """Of a clone, as an index would take them: ``twine check --strict`` renders the README and reads the metadata."""
    pytest.importorskip("twine")
    source = tmp_path / "source"
    ignored = shutil.ignore_patterns("__pycache__", ".git", ".venv", "build", "outputs", "results", "*_cache")
    shutil.copytree(REPOSITORY, source, ignore=ignored)
    build = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(tmp_path / "dist"), str(source)]
    done = subprocess.run(build, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    built = sorted((tmp_path / "dist").iterdir())
    assert [path.name.rpartition(".")[2] for path in built] == ["whl", "gz"]
    check = [sys.executable, "-m", "twine", "check", "--strict", *map(str, built)]
    done = subprocess.run(check, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    with tarfile.open(built[1]) as file:
        names = {name.partition("/")[2] for name in file.getnames()}
    assert {"docs/index.md", "paper/paper.bib", "tests/conftest.py", "CITATION.cff", "LICENSE"} <= names


SCRIPT = """
import json, bench, conf, methods
from bench.config.choices import choices
from bench.entrants.registry import registered
from bench.reporting.paper import printed
files = [module.__file__ for module in (bench, conf, methods)]
print(json.dumps([files, sorted(registered()), choices("experiment"), choices("method"), len(printed())]))
"""


@pytest.mark.slow
def test_an_installed_wheel_knows_its_methods_and_tables(site: Path, python: Callable[..., Any]) -> None:
    done = python("-c", SCRIPT, env={"PYTHONPATH": str(site)})
    files, methods, experiments, variants, numbers = json.loads(done.stdout)
    assert [Path(file).parents[1] for file in files] == [site] * 3
    assert {"ls", "rls", "ddnn", "pinn", "shooting", "sindy", "mcmc"} <= set(methods)
    assert {"table2", "table3", "table4", "table5"} <= set(experiments)
    assert "pinn_adam" in variants
    assert numbers == 59
    assert os.access(site / "bin" / "vibration-bench", os.X_OK)
