"""What goes with a release says the same thing everywhere: version, date, citation, the paper and its bibliography."""

from __future__ import annotations

import re
import tomllib

import yaml
from conftest import REPOSITORY

import bench

PAPER = (REPOSITORY / "paper" / "paper.md").read_text(encoding="utf-8")
BIBLIOGRAPHY = (REPOSITORY / "paper" / "paper.bib").read_text(encoding="utf-8")


def test_one_version_and_one_date() -> None:
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    citation = yaml.safe_load((REPOSITORY / "CITATION.cff").read_text(encoding="utf-8"))
    releases = re.findall(r"^## \[(\d[\d.]*)\] - (\S+)$", (REPOSITORY / "CHANGELOG.md").read_text("utf-8"), re.M)
    assert (project["version"], citation["version"]) == (bench.__version__,) * 2
    assert releases[0] == (str(citation["version"]), citation["date-released"])


def test_the_citation_has_what_its_format_asks_for() -> None:
    """The required keys of the Citation File Format 1.2.0, and the licence that the project states."""
    citation = yaml.safe_load((REPOSITORY / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["cff-version"] == "1.2.0"
    assert {"message", "title", "authors"} <= set(citation)
    assert all({"name"} <= set(one) or {"family-names", "given-names"} <= set(one) for one in citation["authors"])
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert citation["license"] == project["license"]


def test_the_paper_has_the_header_and_the_sections_that_joss_asks_for() -> None:
    _, header, body = PAPER.split("---\n", 2)
    fields = yaml.safe_load(header)
    assert {"title", "tags", "authors", "affiliations", "date", "bibliography"} <= set(fields)
    assert (REPOSITORY / "paper" / fields["bibliography"]).is_file()
    assert {str(one["affiliation"]) for one in fields["authors"]} <= {
        str(one["index"]) for one in fields["affiliations"]
    }
    assert {"Summary", "Statement of need", "References"} <= set(re.findall(r"^# (.*)$", body, re.MULTILINE))
    assert 250 <= len(body.split()) <= 1750


def test_what_is_cited_is_in_the_bibliography_and_the_other_way_round() -> None:
    assert set(re.findall(r"@(\w+)\]", PAPER)) == set(re.findall(r"^@\w+\{(\w+),$", BIBLIOGRAPHY, re.MULTILINE))


def test_every_python_of_the_workflow_is_one_that_the_project_allows() -> None:
    """3.11 to 3.14, on Linux and macOS."""
    workflow = yaml.safe_load((REPOSITORY / ".github" / "workflows" / "test.yml").read_text(encoding="utf-8"))
    matrix = workflow["jobs"]["test"]["strategy"]["matrix"]
    assert matrix["python"] == ["3.11", "3.12", "3.13", "3.14"]
    assert {name.partition("-")[0] for name in matrix["os"]} == {"ubuntu", "macos"}
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert project["requires-python"] == f">={matrix['python'][0]}"


def test_one_version_of_ruff_checks_commits_and_releases() -> None:
    hooks = yaml.safe_load((REPOSITORY / ".pre-commit-config.yaml").read_text(encoding="utf-8"))["repos"]
    (revision,) = [hook["rev"] for hook in hooks if hook["repo"].endswith("ruff-pre-commit")]
    assert f"ruff=={revision[1:]}" in (REPOSITORY / "constraints.txt").read_text(encoding="utf-8").splitlines()
