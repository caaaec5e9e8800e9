"""The reference names everything there is: public names, commands, fields with their defaults, columns of files."""

from __future__ import annotations

import csv
import inspect
import json
import re
from collections.abc import Iterator
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

import pytest
import yaml
from conftest import REPOSITORY, StoreFactory

import bench
from bench.commands.main import main
from bench.commands.verbs import VERBS
from bench.config.fields import defaults as fields_of_a_run
from bench.conformance.process import MEMORY_MB
from bench.contract.estimate import Status
from bench.engine.method_process import CPU_MARGIN_S, LONGEST_ANSWER
from bench.isolation.limits import LONGEST_FILE
from bench.isolation.processes import READY_S
from bench.scenario.force import ForceSpec
from bench.scenario.scenario import PriorSpec, Scenario, config_path

REFERENCE = REPOSITORY / "docs" / "reference"
RESULTS = REPOSITORY / "results"


def page(name: str) -> str:
    return (REFERENCE / name).read_text(encoding="utf-8")


def lines(text: str) -> Iterator[list[str]]:
    """The lines of all tables of a text, cell by cell."""
    for line in re.findall(r"^\| (.*) \|$", text, re.MULTILINE):
        yield [cell.strip() for cell in re.split(r" ?\| ?", line)]


def test_every_public_name_is_on_the_page_once_and_explained() -> None:
    shown = re.findall(r"^::: bench\.(\w+)$", page("python.md"), re.MULTILINE)
    assert sorted(shown) == sorted(bench.__all__)
    for name in bench.__all__:
        value = getattr(bench, name)
        if inspect.isclass(value) or inspect.isfunction(value):
            assert inspect.getdoc(value), name


def test_the_commands_whose_help_is_shown_are_all() -> None:
    """Those of a run and of every verb."""
    pytest.importorskip("mkdocs")
    from importlib.util import module_from_spec, spec_from_file_location

    spec = spec_from_file_location("hooks", REPOSITORY / "docs" / "hooks.py")
    assert spec is not None
    assert spec.loader is not None
    hooks = module_from_spec(spec)
    spec.loader.exec_module(hooks)
    assert hooks.PLACE in page("commands.md")
    assert hooks.helps().keys() == {"", *VERBS}


def defaults() -> dict[str, str]:
    """Of each field on the page of the configuration, its default as it is written there."""
    found = {}
    for cells in lines(page("configuration.md")):
        names = re.findall(r"`([\w.]+)`", cells[0])
        for name in names:
            found.setdefault(name, cells[1].strip("`"))
    return found


def test_every_field_of_a_cell_is_there_with_its_default() -> None:
    config = yaml.safe_load((REPOSITORY / "conf" / "config.yaml").read_text(encoding="utf-8"))
    shown = defaults()
    for name, value in fields_of_a_run().items():
        assert name in shown, name
        if isinstance(value, bool | int | str):
            assert shown[name] == (str(value).lower() if isinstance(value, bool) else str(value)), name
    groups = {key: value for entry in config["defaults"] if isinstance(entry, dict) for key, value in entry.items()}
    assert {"method", "system", "prior", "disturbance", "experiment"} == set(groups)
    assert {name: shown[name] for name in ("method", "system", "disturbance")} == {
        name: groups[name] for name in ("method", "system", "disturbance")
    }


@pytest.mark.parametrize(("kind", "heading"), [(Scenario, "Fields of a scenario"), (ForceSpec, "Of a force")])
def test_every_field_of_a_scenario_and_of_a_force_is_there_with_its_default(kind: type[Any], heading: str) -> None:
    text = page("configuration.md").partition(heading)[2].partition("\n## ")[0]
    text = text.partition("Of a force")[0] if kind is Scenario else text
    shown = {name: cells[1] for cells in lines(text) for name in re.findall(r"`(\w+)`", cells[0])}
    for field in fields(kind):
        name = config_path(field).removeprefix("system.") if kind is Scenario else field.name
        if name in ("snr", "initial_state", "prior", "disturbance"):
            continue  # fields of a cell
        if kind is Scenario and name == "kind" and field.name != "system":
            continue
        assert name in shown, name
        if isinstance(field.default, int | float | str) and field.default is not MISSING and "," not in shown[name]:
            assert shown[name].strip("`") in (
                f"{field.default:g}" if not isinstance(field.default, str) else field.default,
                "",
            ), name


def test_every_field_of_a_prior_is_there() -> None:
    shown = defaults()
    assert {field.name for field in fields(PriorSpec)} <= set(shown)


def test_the_limits_of_a_fit_are_those_that_hold() -> None:
    text = page("configuration.md").partition("### Limits of a fit")[2].partition("\n## ")[0]
    shown = {cells[0].partition(",")[0].partition(":")[0]: cells[1:] for cells in lines(text)}
    assert shown["what it prints"] == [f"{LONGEST_FILE >> 20} MB", f"`{Status.CRASHED}`"]
    assert shown["its answer"] == [f"{LONGEST_ANSWER >> 20} MB", f"`{Status.INVALID}`"]
    assert shown["processor time"] == [f"`timeout_s` and {CPU_MARGIN_S:g} s", f"`{Status.TIMEOUT}`"]
    assert shown["time to start and to import its packages"][0] == f"{READY_S:g} s"
    assert {one for *_, status in shown.values() for one in re.findall(r"`(\w+)`", status)} <= set(map(str, Status))
    assert f"with {MEMORY_MB:g} MB" in text


def dictionary() -> dict[str, set[str]]:
    """Of each CSV of results, the columns that the page of the formats explains for it, shared ones included."""
    sections = re.split(r"^## ", page("file_formats.md"), flags=re.MULTILINE)
    columns = {
        part.partition("\n")[0]: {c for cells in lines(part) for c in re.findall(r"`([^`]+)`", cells[0])}
        for part in sections
    }
    shared = columns["Columns that tables share"]
    return {name: shared | own for title, own in columns.items() for name in re.findall(r"`([\w.]+)`", title)}


@pytest.mark.parametrize("path", sorted(RESULTS.glob("*.csv")), ids=lambda path: path.name)
def test_every_column_of_a_published_file_is_explained(path: Path) -> None:
    with path.open(encoding="utf-8") as file:
        header = next(csv.reader(file))
    known = dictionary()[path.name]
    assert [column for column in header if column.removesuffix(": median") not in known] == []


def test_every_key_of_a_stored_cell_is_explained(new_store: StoreFactory) -> None:
    store = new_store()
    assert main(["method=oracle", "replicates=1", "workers=1", f"store={store.folder}", "format=json"]) == 0
    (path,) = store.folder.glob("*.json")
    section = page("file_formats.md").partition("## A stored cell")[2].partition("\n## ")[0]
    known = {name for cells in lines(section) for name in re.findall(r"`(\w+)`", cells[0])}
    head = json.loads(path.read_text(encoding="utf-8").splitlines()[0])
    assert set(head) - known == set()
