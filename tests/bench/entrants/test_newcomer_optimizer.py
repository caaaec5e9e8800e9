"""The tutorial's example of a new optimiser, taken from its page to the letter, and what is said of broken ones."""

from __future__ import annotations

import csv
import re
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest
from conftest import REPOSITORY, Python, StoreFactory, install

from bench import Status
from bench.commands.main import main
from bench.scenario.scenario import Scenario
from bench.store.version import described_version
from methods.pinn_family import PINNFamily, choices

pytest.importorskip("torch")
PAGE = REPOSITORY / "docs" / "gallery" / "add_optimizer.md"
CODE = re.findall(r"```python title=\"lion_pinn.py\"\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)[0]
MORE = '''
import numpy as np

from methods.pinn_family import Features, Weighting

class ShortLion(Lion):
    """Ends after a few steps."""

    title = "Lion, 20 steps"

    def minimise(self, loss, z):
        for _ in range(20):
            value, gradient = loss.gradient(z)
            z = z - self.rate * torch.sign(gradient)
        return z


class Nameless(Lion):
    title = source = ""


class Idle(Optimizer):
    title = source = "idle"


class Versionless(Lion):
    version = "new"


class HalfPhysics(Weighting):
    title = source = "half the weight of the physics"
    every = 1

    def update(self, residuals, state):
        self.weights[1] = 0.5


class Sines(Features):
    title = source = "one layer of sines"

    def start(self, cycles, rng):
        rates = 4.0 * np.pi * max(cycles, 1.0) * rng.uniform(-1.0, 1.0, (self.width, 1))
        return [rates, rng.uniform(-3.0, 3.0, self.width)]

    def jet(self, parts, time):
        return time.linear(*parts).sin()
'''
CLASSES = {
    "lion": "Lion", "short_lion": "ShortLion", "nameless": "Nameless", "idle": "Idle", "versionless": "Versionless",
    "nowhere": "Nowhere", "torch": "torch",
}  # fmt: skip
CLASS = {"half": "HalfPhysics", "sines": "Sines"}
FAMILY = ("method=pinn_family", "replicates=1", "workers=1")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, str]]:
    """A folder with the module of the page and more, registered as an installed package; the environment with it."""
    folder = tmp_path_factory.mktemp("site")
    (folder / "lion_pinn.py").write_text(CODE + MORE, encoding="utf-8")
    points = "".join(f"{name} = lion_pinn:{cls}\n" for name, cls in CLASSES.items())
    return folder, install(folder, "lion_pinn", f"[pinn_family.optimizers]\n{points}")


def test_it_is_at_most_thirty_lines() -> None:
    assert len(CODE.splitlines()) <= 30


@pytest.mark.slow
def test_its_row_stands_beside_the_others_and_is_computed_by_its_version(
    site: tuple[Path, dict[str, str]], python: Python, new_store: StoreFactory, tmp_path: Path
) -> None:
    """A small sweep of the family's experiment, its base beside it."""
    folder, env = site
    store = new_store()
    sweep = ("-m", "bench", "-m", "experiment=pinn", *FAMILY, "snr=20", "initial_state=known", f"store={store.folder}")
    done = python(*sweep, "method.optimizer=short_lion", env=env)
    assert done.returncode == 0, done.stderr
    (stored,) = (store.load(identity) for identity in store.identities())
    assert stored.version["optimizer lion_pinn:ShortLion"] == 1
    tables = ("-m", "bench", "tables", f"store={store.folder}", "archive=none", f"out={tmp_path}", f"tex={tmp_path}")
    done = python(*tables, env=env)
    assert done.returncode == 0, done.stderr
    lines = csv.DictReader((tmp_path / "pinn_family.csv").read_text(encoding="utf-8").splitlines())
    errors = {
        (line["section"], line["base"], line["row"]): line
        for line in lines
        if (line["quantity"], line["snr_db"], line["initial_state"]) == ("k_over_m_excess", "20", "known")
    }
    beside = errors["Optimisers", "our base", "Lion, 20 steps"]
    assert (beside["method"], beside["settings"], beside["n"]) == ("pinn_family", '{"optimizer": "short_lion"}', "1")
    assert float(beside["value"]) > 0.0
    assert ("Optimisers", "our base", "Levenberg-Marquardt") in errors
    page = (tmp_path / "pinn_family.md").read_text(encoding="utf-8")
    assert "- Lion, 20 steps: X. Chen et al., NeurIPS 2023 (lion_pinn 1.0)" in page

    module = folder / "lion_pinn.py"
    text = module.read_text(encoding="utf-8")
    module.write_text(text.replace("version = 1", "version = 2"), encoding="utf-8")
    try:
        done = python("-m", "bench", "status", f"store={store.folder}", "archive=none", env=env)
        assert "optimizer lion_pinn:ShortLion version 1, today 2" in done.stdout
    finally:
        module.write_text(text, encoding="utf-8")
    done = python("-m", "bench", "status", f"store={store.folder}", "archive=none")  # where it is not installed
    assert "method.optimizer=short_lion: no installed package supplies it" in done.stdout


@pytest.fixture
def installed(site: tuple[Path, dict[str, str]], monkeypatch: pytest.MonkeyPatch) -> None:
    """The same in this process."""
    monkeypatch.syspath_prepend(str(site[0]))
    classes = {"optimizer": CLASSES, "weighting": {"half": "HalfPhysics"}, "architecture": {"sines": "Sines"}}
    points = {
        f"pinn_family.{setting}s": {name: EntryPoint(name, f"lion_pinn:{cls}", "") for name, cls in own.items()}
        for setting, own in classes.items()
    }
    monkeypatch.setattr(choices, "entry_points_of", points.__getitem__)


def test_the_pages_class_trains(installed: None, reference: Scenario) -> None:
    """300 gradients take the loss down."""
    problem = next(iter(reference.replicates(0, 1)))[0]
    estimate = PINNFamily(optimizer="lion", budget=300.0).identify(problem, np.random.default_rng(0))
    assert estimate.status is Status.OK
    assert estimate.traces["path_loss"][-1] < 0.5 * estimate.traces["path_loss"][0]


@pytest.mark.slow
@pytest.mark.parametrize(("setting", "name"), [("weighting", "half"), ("architecture", "sines")])
def test_a_weighting_and_a_function_of_time_from_outside_find_the_stiffness(
    setting: str, name: str, installed: None, reference: Scenario
) -> None:
    """As the family's own do: within a few of the answer's own standard deviations of the truth."""
    problem, truth = next(iter(reference.replicates(0, 1)))
    estimate = PINNFamily(**{setting: name}).identify(problem, np.random.default_rng(0))
    k_over_m = estimate.marginal(problem.system.quantity("k_over_m"))
    assert k_over_m.value == pytest.approx(truth.parameters["k"] / truth.parameters["m"], rel=0.05)
    cell = {"method": "pinn_family", "data": {"system": "sdof"}, "settings": {setting: name}}
    assert described_version(cell).as_json()[f"{setting} lion_pinn:{CLASS[name]}"] == 1


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("lyon", "did you mean lion? one of adam, adam_lbfgs"),
        ("nameless", "its entry point (lion_pinn:Nameless) lacks title, source"),
        ("idle", "its entry point (lion_pinn:Idle) lacks minimise"),
        ("versionless", "the version of its entry point (lion_pinn:Versionless) is 'new'; a whole number from 1"),
        ("nowhere", "could not import its entry point (lion_pinn:Nowhere: AttributeError"),
        ("torch", "its entry point (lion_pinn:torch) must name a subclass of Optimizer"),
    ],
)
def test_what_is_unknown_or_broken_is_one_line(
    name: str, words: str, installed: None, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*FAMILY, f"method.optimizer={name}"]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"bench: method.optimizer={name}: {words}")
    assert error.count("\n") == 1
    assert (", lion, " in error) == (name == "lyon")
