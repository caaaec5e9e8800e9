"""The verb ``tables``: tables, figures, claims and the reproduction of the paper, from stored cells."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from bench.commands.declaration import folder
from bench.commands.stores import OWN, ArchiveFolder, StoreFolder, named_store
from bench.errors import InputError

if TYPE_CHECKING:
    from bench.reporting.claims.document import Checked
    from bench.reporting.frame import Frame

RESULTS, TEX, FIGURES = Path("results"), Path("build/tables"), Path("results/figures")
Out = Annotated[Path, "folder of the files"]


def tables(
    store: StoreFolder = OWN,
    archive: ArchiveFolder = None,
    out: Out = RESULTS,
    tex: Annotated[Path, "folder of the LaTeX tables"] = TEX,
) -> int:
    """Write the tables of all experiments as Markdown, CSV and LaTeX; what=figures, claims, reproduction or all.

    From stored cells alone: a table is what its experiment in conf describes, and a missing cell is a row that says so.
    A submitted method appears in the tables of which it has every scenario, and is marked.
    """
    from bench.reporting.frame import experiment_frame, submitted_results, table_experiments, with_submitted
    from bench.reporting.tables.forms import table_files
    from bench.reporting.tables.leaderboard import EXPERIMENTS, leaderboard
    from bench.reporting.whole_file import check_folder

    opened = named_store(store, archive, filled=True)
    check_folder(out)
    check_folder(tex, "tex")
    pooled, drawn, submitted, written = [], None, submitted_results(opened), 0
    for name in table_experiments():
        frame = with_submitted(experiment_frame(name, opened), submitted)
        files = table_files(frame, opened)
        if files:
            _warn_if_stale(frame)
        else:
            print(f"{name}: no cells stored; run python -m bench -m experiment={name}", file=sys.stderr)
        written += _write(files, out, tex)
        pooled += [frame] if name in EXPERIMENTS else []
        drawn = frame if frame.table.get("form") == "open" else drawn
    written += _write(leaderboard(pooled, drawn), out, tex)
    if not written:
        raise InputError("store", store, "none of its cells is in a table; see python -m bench status")
    return 0


def figures(
    store: StoreFolder = OWN,
    archive: ArchiveFolder = None,
    out: Out = FIGURES,
    svg: Annotated[Path | None, "folder of the same figures as SVG [none]"] = None,
) -> int:
    """Draw the figures as PNG files with captions; a figure that lacks its cells is left out, with the reason."""
    from bench.reporting.whole_file import check_folder

    opened = named_store(store, archive, filled=True)
    check_folder(out)
    if svg is not None:
        check_folder(svg, "svg")
    try:
        from bench.reporting.figures.gallery import Gallery, Nothing
        from bench.reporting.figures.pictures import PICTURES, write_picture

        gallery, drawn = Gallery(opened), 0
        for name in PICTURES:
            try:
                paths = write_picture(gallery, name, out, svg)
            except Nothing as reason:
                print(f"bench tables: {name}: not drawn: {reason}", file=sys.stderr)
                continue
            drawn += 1
            print(*paths, sep="\n")
    except ImportError as error:
        if "matplotlib" not in str(error):
            raise
        raise InputError("package", "matplotlib", "missing: pip install 'vibration-bench[figures]'") from None
    if not drawn:
        raise InputError("store", store, "no cell there has what a picture needs; run experiment=table5")
    return 0


def claims(
    store: StoreFolder = OWN,
    archive: ArchiveFolder = None,
    results: Annotated[Path, "folder of tables"] = RESULTS,
    root: Annotated[Path, "folder of README.md, paper, docs and results/README.md"] = Path("."),
    write: Annotated[bool, "fill in the numbers of the documents, and the panels of tables"] = False,
) -> int:
    """Check every claim of the documents against the results it rests on.

    Prints for each claim whether it holds, its numbers and its conditions. Exit status: 0, 1 where a claim does not
    hold, a document differs, or a number is typed by hand, 2 for bad input.
    """
    from bench.reporting.claims.document import check, documents, typed_in_claims
    from bench.reporting.claims.evidence import Evidence
    from bench.reporting.whole_file import write as write_file

    evidence = Evidence(folder("results", results), named_store(store, archive))
    pages = documents(folder("root", root))
    checked = list(check(pages, evidence))
    filled = [page.written(checked, results) for page in pages]
    if write and filled != pages:
        for page in (page for page in filled if page not in pages):
            write_file(root / page.path, page.text, field="root")
            print(f"{page.path}: written", file=sys.stderr)
        pages, checked = filled, list(check(filled, evidence))
    for claim in checked:
        print(_lines(claim))
    typed = [f"{page.path}: {place}" for page in pages for place in page.typed()]
    typed += [f"claim {name}: {place}" for name, places in typed_in_claims().items() for place in places]
    for place in typed:
        print(f"typed by hand: {place}")
    passed = sum(claim.passes for claim in checked)
    print(f"{passed} of {len(checked)} claims pass; {len(typed)} numbers are typed by hand")
    for page in (page for page, new in zip(pages, filled, strict=True) if page != new):
        print(f"{page.path}: its passages or the panel of a table differ: write=true fills them in")
    return 0 if passed == len(checked) and not typed and pages == filled else 1


def reproduction(store: StoreFolder = OWN, archive: ArchiveFolder = None, out: Out = RESULTS) -> int:
    """Judge each of the paper's 59 numbers, under the protocol and under other readings of it.

    Cells that the store lacks are run first, where it holds some.
    """
    from bench.engine.launch import complete
    from bench.engine.pool import Limits
    from bench.isolation.machine import usable_cores
    from bench.reporting.frame import Result
    from bench.reporting.reproduction import all_cells, ratio_verdicts, verdicts
    from bench.reporting.reproduction_page import files
    from bench.reporting.whole_file import check_folder

    opened = named_store(store, archive, filled=True)
    check_folder(out)
    opened.prepare()
    cells = all_cells()
    wanted = {cell.identity: cell for places in cells.values() for cell in places.values()}
    complete(list(wanted.values()), opened, Limits(usable_cores()))
    results = {identity: Result.of_cell(cell, opened.load(identity)) for identity, cell in wanted.items()}
    judged = {name: {place: results[cell.identity] for place, cell in own.items()} for name, own in cells.items()}
    _write(files(verdicts(judged), ratio_verdicts(judged), next(iter(cells.values()))), out, out)
    return 0


def everything(store: StoreFolder = OWN, archive: ArchiveFolder = None) -> int:
    """Write tables, figures and the reproduction into results/, and fill the numbers of the documents in."""
    tables(store, archive)
    figures(store, archive)
    reproduction(store, archive)
    return claims(store, archive, write=True)


VARIANTS = {
    "what=tables": tables, "what=figures": figures, "what=claims": claims, "what=reproduction": reproduction,
    "what=all": everything,
}  # fmt: skip


def _write(files: Mapping[str, str], out: Path, tex: Path) -> int:
    """Write files by name and print their paths; returns how many."""
    from bench.reporting.whole_file import write

    for name, content in files.items():
        place = tex if name.endswith(".tex") else out
        write(place / name, content, place)
        print(place / name)
    return len(files)


def _warn_if_stale(frame: Frame) -> None:
    """Print a line on the error stream where a table rests on cells of another version."""
    unique = {result.identity: result for result in frame}.values()
    stale = [(one.cell.version, one.stored.version) for one in unique if one.cell and one.stored]
    stale = [(now, then) for now, then in stale if not now.is_that_of(then)]
    if stale:
        now, then = stale[0]
        cells = f"{len(stale)} of {len(unique)} cells are stale ({now.changed_since(then)[:100]})"
        remedy = f"python -m bench -m experiment={frame.experiment} computes them again"
        print(f"{frame.experiment}: {cells}; {remedy}", file=sys.stderr)


def _lines(claim: Checked) -> str:
    """Return a claim: whether it holds, its numbers and its conditions."""
    if claim.said is None:
        return f"{claim.claim.name}: UNKNOWN: {claim.problem}"
    wrong = [f"FALSE: {condition}" for condition in claim.said.broken]
    wrong += [] if claim.agrees else ["THE TEXT DIFFERS OR IS IN NO DOCUMENT: write=true fills it in"]
    numbers = ", ".join(f"{name} {value}" for name, value in claim.said.numbers.items())
    conditions = "; ".join(claim.said.conditions)
    return f"{claim.claim.name}: {'; '.join(wrong) or 'holds'}\n    {numbers}\n    while {conditions}"
