"""Complete the pages of docs/ when the site is built: numbers, results, generated tables, links to the glossary."""

from __future__ import annotations

import csv
import dataclasses
import io
import posixpath
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import redirect_stdout
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files, InclusionLevel

ROOT = Path(__file__).parents[1]
FIRST = "<!-- the site has the first screen of the results in place of what is above -->"
README = "readme.md"
"""Path of README.md in the site, whose first page is docs/index.md."""
ROOT_DOCUMENTS = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "CITATION.cff", "LICENSE", "SECURITY.md")
PUBLISHED = (".md", ".png")
"""Suffixes of the files of results/ that the site contains."""
LINK = re.compile(r"\[(?P<text>[^\[\]]*)\]\((?P<target>[^)#\s]+)(?P<part>#[^)\s]*)?\)")
GLOSSARY = "reference/glossary.md"
ENTRY = re.compile(r"^### (?P<term>.+)\n(?P<meaning>.+)$", re.MULTILINE)
NOT_PROSE = re.compile(
    r"(^```.*?^```|^#.*?$|^:::.*?$|^\?\?\?.*?$|^\|.*?$|`[^`\n]*`|!?\[[^\[\]]*\]\([^)]*\)|<!--.*?-->|<[^>\n]+>)",
    re.DOTALL | re.MULTILINE,
)
"""Parts of a page that get no link to the glossary: code, headings, tables, links, comments and tags."""
LINKED_TO_GLOSSARY = re.compile(r"results/.*\.md|which_method\.md|trust\.md|readme\.md")
"""Pages outside of docs/ that link to the glossary too."""
COMMON_WORDS = (
    "alternative",
    "archive",
    "audit",
    "bound",
    "card",
    "cell",
    "identifiable",
    "round",
    "store",
    "track",
    "verdict",
)
"""Terms that are ordinary words too; they are linked behind an article only."""


def on_files(files: Files, config: MkDocsConfig, **_: Any) -> Files:
    """Add the results, the documents of the root, and the pages made from the archive."""
    results = [path for path in sorted((ROOT / "results").rglob("*")) if path.suffix in PUBLISHED]
    for path in (*(ROOT / name for name in ROOT_DOCUMENTS), *results):
        name = path.relative_to(ROOT).as_posix()
        place = README if name == "README.md" else name
        files.append(File.generated(config, place, abs_src_path=str(path), inclusion=InclusionLevel.NOT_IN_NAV))
    for name, content in _pages().items():
        if name != "index.md":
            files.append(File.generated(config, name, content=content, inclusion=InclusionLevel.NOT_IN_NAV))
    return files


def on_page_read_source(page: Any, **_: Any) -> str | None:
    """Begin the first page with the first screen of the results."""
    if page.file.src_uri != "index.md":
        return None
    return _pages()["index.md"].decode() + (ROOT / "docs" / "index.md").read_text(encoding="utf-8").partition(FIRST)[2]


def on_page_markdown(markdown: str, page: Any, config: MkDocsConfig, files: Files, **_: Any) -> str:
    """Fill in numbers and generated tables, redirect links to their place in the site, and link to the glossary."""
    source, documents = page.file.src_uri, import_module("bench.reporting.documents")
    written_here = (ROOT / "docs" / source).is_file()
    if (written_here or source == README) and any(documents.used(markdown)):
        markdown = documents.filled(markdown, _facts())
    for mark, generate in GENERATED.items():
        if mark in markdown:
            markdown = markdown.replace(mark, generate())

    def redirected(link: re.Match[str]) -> str:
        if re.match(r"\w+:|/", link["target"]):
            return link[0]
        target = _place(source, link["target"])
        inside = posixpath.relpath(target, posixpath.dirname(source) or ".")
        if files.get_file_from_path(target):
            return f"[{link['text']}]({inside}{link['part'] or ''})"
        if (ROOT / target).exists():
            return f"[{link['text']}]({config.repo_url}/blob/main/{target})" if config.repo_url else link["text"]
        return link[0]

    markdown = LINK.sub(redirected, markdown)
    if source not in (GLOSSARY, "index.md") and (written_here or LINKED_TO_GLOSSARY.match(source)):
        markdown = linked_to_glossary(markdown, posixpath.relpath(GLOSSARY, posixpath.dirname(source) or "."))
    return markdown


def on_post_page(output: str, page: Any, **_: Any) -> str:
    """Link the footer to the citation."""
    cite = f'<a href="{"../" * page.url.count("/")}index.html#how-to-cite">how to cite</a>'
    return output.replace("to cite: CITATION.cff", cite)


def linked_to_glossary(markdown: str, glossary: str) -> str:
    """Link the first use of each glossary term in a page, with its meaning as the link's title.

    Args:
        markdown: The page.
        glossary: Address of the glossary, relative to the page.

    Returns:
        The page; code, headings, tables and existing links are unchanged.
    """
    remaining = {term.lower(): meaning for term, meaning in glossary_entries().items()}

    def link(use: re.Match[str]) -> str:
        term = use["term"].lower()
        if term not in remaining or (term in COMMON_WORDS and not use["article"]):
            return use[0]
        title = re.sub(r"[*`]", "", remaining.pop(term)).replace('"', "'")
        anchor = term.replace(" ", "-")
        return f'{use["article"] or ""}[{use["term"]}{use["plural"]}]({glossary}#{anchor} "{title}")'

    terms = "|".join(sorted(map(re.escape, remaining), key=len, reverse=True))
    pattern = re.compile(
        rf"(?P<article>\b(?:an?|the|each|every|one|per|Cramér-Rao) )?\b(?P<term>{terms})(?P<plural>s?)\b(?![-=])",
        re.IGNORECASE,
    )
    parts = NOT_PROSE.split(markdown)
    return "".join(part if i % 2 else pattern.sub(link, part) for i, part in enumerate(parts))


@cache
def glossary_entries() -> dict[str, str]:
    """Return the meaning of each term of the glossary."""
    text = (ROOT / "docs" / GLOSSARY).read_text(encoding="utf-8")
    return {entry["term"]: entry["meaning"] for entry in ENTRY.finditer(text)}


def _place(source: str, target: str) -> str:
    """Return the path in the site of a link's target; docs/ is the root there, next to results/."""
    outside = source in (README, *ROOT_DOCUMENTS) or source.startswith("results/")
    folder = posixpath.dirname(source if outside else f"docs/{source}")
    path = posixpath.normpath(posixpath.join(folder, target))
    if path.startswith("results") and (ROOT / path).is_dir():
        return "results/README.md"
    return README if path == "README.md" else path.removeprefix("docs/")


def helps() -> dict[str, str]:
    """Return the help page of a run, under the empty name, and of every verb."""
    main, verbs = import_module("bench.commands.main").main, import_module("bench.commands.verbs").VERBS
    pages = {}
    for verb in ("", *verbs):
        page = io.StringIO()
        with redirect_stdout(page):
            main([*([verb] if verb else []), "--help"])
        pages[verb] = page.getvalue().strip()
    return pages


def help_pages() -> str:
    """Return the help pages as sections."""
    titles = {verb: f"python -m bench {verb}".strip() for verb in helps()}
    return "\n\n".join(f"## `{titles[verb]}`\n\n```text\n{text}\n```" for verb, text in helps().items())


def field_table(declared: Mapping[str, Any], names: Mapping[str, str], defaults: Mapping[str, str]) -> str:
    """Return a table of fields with their defaults and, where there are few, their choices.

    Args:
        declared: The fields by name.
        names: Fields to list, with the name to show for each.
        defaults: Defaults that the declaration does not state.

    Returns:
        The table in Markdown.
    """
    declaration = import_module("bench.config.declaration")
    rows = []
    for name, shown in names.items():
        field = declared[name]
        stated = isinstance(field.default, str | int | float | Path)
        default = defaults.get(name, declaration.written(field.default) if stated else "")
        choices = () if bool in field.types or len(field.choices) > declaration.MOST_LISTED else field.choices
        meaning = "; ".join([field.text, *([", ".join(choices)] if choices and name not in defaults else [])])
        rows.append((f"`{shown}`", f"`{default}`" if default else "", meaning))
    return table(("field", "default", "meaning"), rows)


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table in Markdown; angle brackets outside of code are shown as they are."""
    lines = [
        head,
        ["---"] * len(head),
        *([v if v.startswith("`") else v.replace("<", "&lt;") for v in r] for r in rows),
    ]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def run_fields() -> str:
    """Return the table of the fields of a cell and of a run."""
    fields, choices = import_module("bench.config.fields"), import_module("bench.config.choices")
    names = [name for name in fields.declared() if name not in ("data", *fields.RECORD)]
    rows = field_table(
        fields.declared(), dict(zip(names, names, strict=True)), choices.default_choices() | {"method": ""}
    )
    return f"{rows}\n| `experiment` | | a sweep of `conf/experiment`; other fields override it |"


def record_fields() -> str:
    """Return the table of the fields of a measured record."""
    fields = import_module("bench.config.fields")
    names = ("data", *fields.RECORD)
    return field_table(fields.declared(), dict(zip(names, names, strict=True)), {})


def scenario_fields() -> str:
    """Return the table of the fields of a scenario, without those of a cell."""
    scenario, fields_of = import_module("bench.scenario.scenario"), import_module("bench.config.declaration").fields_of
    paths = {field.name: scenario.config_path(field) for field in dataclasses.fields(scenario.Scenario)}
    names = {name: path.removeprefix("system.") for name, path in paths.items() if path.startswith("system.")}
    rows = field_table(fields_of(scenario.Scenario), names, {})
    return f"{rows}\n| `default_prior` | `nominal` | prior if none is chosen |"


def force_fields() -> str:
    """Return the table of the fields of a force."""
    return declared_fields(import_module("bench.scenario.force").ForceSpec)


def prior_fields() -> str:
    """Return the table of the fields of a prior."""
    return declared_fields(import_module("bench.scenario.scenario").PriorSpec)


def declared_fields(cls: type) -> str:
    """Return the table of the fields of a dataclass."""
    declared = import_module("bench.config.declaration").fields_of(cls)
    return field_table(declared, dict(zip(declared, declared, strict=True)), {})


def method_table() -> str:
    """Return the table of the methods, with their variants, from their cards."""
    registry = import_module("bench.entrants.registry")
    rows = []
    for name in registry.registered():
        method = registry.load_method(name)
        variants = [
            f"`{variant}`: {changed['summary']}"
            for variant, changed in method.card.variants.items()
            if "summary" in changed
        ]
        principle = ". ".join([method.card.summary, *variants])
        names = ", ".join(f"`{known}`" for known in (name, *method.card.variants))
        rows.append((names, principle, method.card.start, method.card.uncertainty))
    return table(("method", "principle", "initial state", "uncertainty"), rows)


def modal_table() -> str:
    """Return the table of the modal methods, with the data that each takes."""
    points = import_module("bench.entry_points").entry_points_of("bench.modal")
    words = import_module("bench.contract.modal").WORDS
    methods = {name: point.load() for name, point in points.items()}
    rows = [(f"`{n}`", m.card.summary, ", ".join(words[kind] for kind in m.scope)) for n, m in methods.items()]
    return table(("method", "principle", "data"), rows)


def tracker_table() -> str:
    """Return the table of the online methods."""
    points = import_module("bench.entry_points").entry_points_of("bench.trackers")
    return table(("method", "principle"), [(f"`{name}`", point.load().card.summary) for name, point in points.items()])


def column_tables() -> str:
    """Return the data dictionary, docs/reference/columns.csv, as one table per file."""
    with (ROOT / "docs" / "reference" / "columns.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    columns = {
        name: [row for row in rows if row["file"] == name] for name in dict.fromkeys(row["file"] for row in rows)
    }
    tables = {
        name: table(("column", "unit", "meaning"), [(f"`{r['column']}`", r["unit"], r["meaning"]) for r in listed])
        for name, listed in columns.items()
    }
    titles = {name: name.replace("<", "&lt;").replace(".csv ", ".csv, ") for name in tables}
    return "\n\n".join(f"### {titles[name]}\n\n{text}" for name, text in tables.items())


def verdict_table() -> str:
    """Return every number of the paper with the number here and its verdict, from the CSV files of Tables 2 to 5."""
    title = import_module("bench.reporting.labels").title
    rows = []
    for number in "2345":
        with (ROOT / "results" / f"table{number}.csv").open(encoding="utf-8", newline="") as file:
            for row in csv.DictReader(file):
                if row["paper"] and row["verdict"]:
                    metric = row["metric"].replace("_error_pct", " error, %").replace("rmse", "RMSE, m")
                    here = f"{float(row['median']):.3g}" if row["median"] else "–"
                    case = number + {"4": f", set {row['row']}", "5": f", {row['row']} dB"}.get(number, "")
                    values = (row["paper"], here, row["verdict"])
                    rows.append((case, title(row["method"]), metric, row["initial_state"], *values))
    return table(("table", "method", "quantity", "initial state", "paper", "median here", "verdict"), rows)


GENERATED: dict[str, Callable[[], str]] = {
    "<!-- the help of every command, written by docs/hooks.py when the site is built -->": help_pages,
    "<!-- fields of a run -->": run_fields,
    "<!-- fields of a record -->": record_fields,
    "<!-- fields of a scenario -->": scenario_fields,
    "<!-- fields of a force -->": force_fields,
    "<!-- fields of a prior -->": prior_fields,
    "<!-- columns of every file -->": column_tables,
    "<!-- methods -->": method_table,
    "<!-- modal methods -->": modal_table,
    "<!-- online methods -->": tracker_table,
    "<!-- verdicts -->": verdict_table,
}
"""Comments in pages that the build replaces with text from the code."""


@cache
def _facts() -> Any:
    """Return the numbers and conclusions of the documents; an unknown or false one stops the build."""
    return import_module("bench.reporting.sentences").facts(ROOT / "results")


@cache
def _pages() -> dict[str, bytes]:
    """Return the pages of the published results, and the files that they use, by path."""
    store, site = import_module("bench.store.store"), import_module("bench.reporting.page.site")
    published = store.open_store(ROOT / "build" / "no cells of one's own", str(ROOT / "results" / "archive"))
    return dict(site.site_files(published, ROOT / "results"))
