"""The reference is complete: public names, commands, fields with their defaults, columns of files."""

from __future__ import annotations

import csv
import inspect
import json
import re
from collections.abc import Iterator
from dataclasses import fields
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import pyarrow.parquet as pq
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
from bench.scenario.scenario import PriorSpec, Scenario

REFERENCE = REPOSITORY / "docs" / "reference"
RESULTS = REPOSITORY / "results"


def page(name: str) -> str:
    return (REFERENCE / name).read_text(encoding="utf-8")


def lines(text: str) -> Iterator[list[str]]:
    """Iterate over the rows of all tables of a text."""
    for line in re.findall(r"^\| (.*) \|$", text, re.MULTILINE):
        yield [cell.strip() for cell in re.split(r" ?\| ?", line)]


def test_every_public_name_is_on_the_page_once_and_documented() -> None:
    shown = re.findall(r"^::: bench\.(\w+)$", page("python.md"), re.MULTILINE)
    assert sorted(shown) == sorted(bench.__all__)
    for name in bench.__all__:
        value = getattr(bench, name)
        if inspect.isclass(value) or inspect.isfunction(value):
            assert inspect.getdoc(value), name


@pytest.fixture(scope="module")
def hooks() -> ModuleType:
    """The module that completes pages when the site is built."""
    pytest.importorskip("mkdocs")
    spec = spec_from_file_location("hooks", REPOSITORY / "docs" / "hooks.py")
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_generated_part_has_its_place(hooks: ModuleType) -> None:
    """The help of a run and of every verb, the fields with their defaults, the columns of files, the verdicts."""
    pages = "".join(path.read_text(encoding="utf-8") for path in REFERENCE.parent.rglob("*.md"))
    assert [mark for mark in hooks.GENERATED if pages.count(mark) != 1] == []
    assert hooks.helps().keys() == {"", *VERBS}


def test_every_field_of_a_run_is_listed_with_its_default(hooks: ModuleType) -> None:
    shown = {cells[0].strip("`"): cells[1].strip("`") for cells in lines(hooks.run_fields() + hooks.record_fields())}
    assert shown["timeout_s"] == "600"
    assert (shown["workers"], shown["system"], shown["disturbance"]) == ("", "sdof", "none")
    config = yaml.safe_load((REPOSITORY / "conf" / "config.yaml").read_text(encoding="utf-8"))
    groups = {name for entry in config["defaults"] if isinstance(entry, dict) for name in entry}
    assert groups | fields_of_a_run().keys() <= shown.keys()


def test_a_term_of_the_glossary_is_linked_once(hooks: ModuleType) -> None:
    page = "## A cell\n\nThe `excess` of a cell is its *excess*; cells round numbers. A cell, | excess |\n\n| excess |"
    linked = hooks.linked_to_glossary(page, "g.md")
    assert re.findall(r"\[(\w+)\]\(g\.md#(\w+) \"[^\"]+\"\)", linked) == [("cell", "cell"), ("excess", "excess")]
    assert linked.startswith("## A cell\n\nThe `excess` of a [cell]")
    assert linked.endswith("| excess |\n\n| excess |")
    terms = [term.lower() for term in hooks.glossary_entries()]
    assert terms == sorted(terms)
    assert set(hooks.COMMON_WORDS) <= set(terms)


def test_every_field_of_a_scenario_a_force_and_a_prior_is_listed(hooks: ModuleType) -> None:
    scenario, force, prior = (
        {cells[0].strip("`"): cells[1].strip("`") for cells in lines(text)}
        for text in (hooks.scenario_fields(), hooks.force_fields(), hooks.prior_fields())
    )
    of_a_cell = {"snr_db", "initial_state", "prior", "disturbance"}
    assert {field.name for field in fields(Scenario)} - of_a_cell - {"system"} | {"kind"} <= scenario.keys()
    assert (scenario["samples"], scenario["duration"], scenario["kind"]) == ("25", "10", "")
    assert {field.name for field in fields(ForceSpec)} <= force.keys()
    assert {field.name for field in fields(PriorSpec)} <= prior.keys()


def test_the_limits_of_a_fit_are_those_of_the_code() -> None:
    text = page("configuration.md").partition("## Limits of a fit")[2].partition("\n## ")[0]
    shown = {cells[0].partition(",")[0].partition(":")[0]: cells[1:] for cells in lines(text)}
    assert shown["printed output"] == [f"{LONGEST_FILE >> 20} MB", f"`{Status.CRASHED}`"]
    assert shown["estimate"] == [f"{LONGEST_ANSWER >> 20} MB", f"`{Status.INVALID}`"]
    assert shown["processor time"] == [f"`timeout_s` and {CPU_MARGIN_S:g} s", f"`{Status.TIMEOUT}`"]
    assert shown["start-up and import of its packages"][0] == f"{READY_S:g} s"
    assert {name for *_, status in shown.values() for name in re.findall(r"`(\w+)`", status)} <= set(map(str, Status))
    assert f"with {MEMORY_MB:g} MB" in text


def dictionary(shared: bool = True) -> dict[str, set[str]]:
    """Return the columns that the data dictionary explains, by file, with or without those that tables share."""
    with (REFERENCE / "columns.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert all(row["meaning"] or row["column"] == "the shared columns" for row in rows)
    common = {row["column"] for row in rows if shared and row["file"] == "shared by the tables"}
    columns: dict[str, set[str]] = {}
    for row in rows:
        for name in row["file"].split():
            columns.setdefault(name, set(common)).add(row["column"])
    return columns


@pytest.mark.parametrize("path", sorted(RESULTS.glob("*.csv")), ids=lambda path: path.name)
def test_every_column_of_a_published_file_is_explained(path: Path) -> None:
    with path.open(encoding="utf-8") as file:
        header = next(csv.reader(file))
    known = dictionary()[path.name]
    assert [column for column in header if column.removesuffix(": median") not in known] == []


@pytest.mark.parametrize("name", ["cells", "summaries", "arrays", "bounds"])
def test_every_column_of_the_archive_is_explained(name: str) -> None:
    published = set(pq.read_schema(RESULTS / "archive" / f"{name}.parquet").names)
    explained = dictionary(shared=False)[f"{name}.parquet"]
    assert published <= explained
    assert explained - published <= {"supplied_versions"}  # written only where a cell has some


def test_every_key_of_a_stored_cell_is_explained(new_store: StoreFactory) -> None:
    store = new_store()
    assert main(["method=oracle", "replicates=1", "workers=1", f"store={store.folder}", "format=json"]) == 0
    (path,) = store.folder.glob("*.json")
    section = page("file_formats.md").partition("## A stored cell")[2].partition("\n## ")[0]
    known = {name for cells in lines(section) for name in re.findall(r"`(\w+)`", cells[0])}
    head = json.loads(path.read_text(encoding="utf-8").splitlines()[0])
    assert set(head) - known == set()
