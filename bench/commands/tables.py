"""The verb ``tables``: tables, figures, claims from stored cells, and the audits of published claims."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from bench.commands.declaration import folder
from bench.commands.stores import OWN, ArchiveFolder, StoreFolder, named_store
from bench.errors import InputError

if TYPE_CHECKING:
    from bench.reporting.frame import Frame

RESULTS, TEX, FIGURES = Path("results"), Path("build/tables"), Path("results/figures")
Out = Annotated[Path, "folder of the files"]


def tables(
    store: StoreFolder = OWN,
    archive: ArchiveFolder = None,
    out: Out = RESULTS,
    tex: Annotated[Path, "folder of the LaTeX tables"] = TEX,
) -> int:
    """Write the tables of all experiments as Markdown, CSV and LaTeX; what=frame, figures, claims, ...

    From stored cells alone: a table is what its experiment in conf describes, and a missing cell is a row that says so.
    A submitted method appears in the tables of which it has every scenario, and is marked.
    """
    from bench.reporting.frame import experiment_frame, submitted_results, table_experiments, with_submitted
    from bench.reporting.tables.forms import table_files
    from bench.reporting.whole_file import check_folder

    opened = named_store(store, archive, filled=True)
    check_folder(out)
    check_folder(tex, "tex")
    submitted, written = submitted_results(opened), 0
    for name in table_experiments():
        frame = with_submitted(experiment_frame(name, opened), submitted)
        files = table_files(frame)
        if files:
            _warn_if_stale(frame)
        else:
            print(f"{name}: no cells stored; run python -m bench -m experiment={name}", file=sys.stderr)
        written += _write(files, out, tex)
    if not written:
        raise InputError("store", store, "none of its cells is in a table; see python -m bench status")
    return 0


def frame(
    experiment: Annotated[str | None, "print the lines of this experiment instead [none]"] = None,
    metric: Annotated[str, "of the lines that are printed"] = "k_over_m_error_pct",
    store: StoreFolder = OWN,
    archive: ArchiveFolder = None,
    out: Annotated[Path, "file of the frame"] = Path("build/frame.parquet"),
) -> int:
    """Write one frame of everything that tables show: a line a cell and metric, with ties, verdicts and what is stale.

    pandas.read_parquet reads it.
    """
    from bench.reporting.frame import experiment_frame, table_experiments
    from bench.reporting.tables.tidy import frame_page, tidy_frame
    from bench.reporting.whole_file import check_file, write

    names = table_experiments()
    if experiment and experiment not in names:
        raise InputError("experiment", experiment, f"one of: {', '.join(names)}")
    opened = named_store(store, archive, filled=True)
    check_file(out)
    data = tidy_frame(experiment_frame(name, opened) for name in ([experiment] if experiment else names))
    if experiment:
        print(frame_page(data, metric))
        return 0
    write(out, data.to_parquet(index=False), out.parent, "out")
    print(f"{out}: {len(data)} lines")
    return 0


def figures(
    store: StoreFolder = OWN,
    archive: ArchiveFolder = None,
    out: Out = FIGURES,
    svg: Annotated[
        Path | None, "folder of the same figures as SVG and, of charts, the interactive specification [none]"
    ] = None,
) -> int:
    """Draw the figures as PNG files with captions; a figure that lacks its cells is left out, with the reason."""
    from bench.reporting.whole_file import check_folder

    opened = named_store(store, archive, filled=True)
    check_folder(out)
    if svg is not None:
        check_folder(svg, "svg")
    try:
        from bench.reporting.pictures.all_pictures import PICTURES
        from bench.reporting.pictures.gallery import Gallery
        from bench.reporting.pictures.style import Nothing, save

        gallery, drawn = Gallery(opened), 0
        for name, draw in PICTURES.items():
            try:
                paths = save(draw(gallery), out, svg)
            except Nothing as reason:
                print(f"bench tables: {name}: not drawn: {reason}", file=sys.stderr)
                continue
            drawn += 1
            print(*paths, sep="\n")
    except ImportError as error:
        if error.name not in ("altair", "matplotlib", "vl_convert"):
            raise
        raise InputError("package", error.name, "missing: pip install 'vibration-bench[figures]'") from None
    if not drawn:
        raise InputError("store", store, "no cell there has what a picture needs; run experiment=table5")
    return 0


def claims(
    results: Annotated[Path, "folder of tables and of the archive"] = RESULTS,
    root: Annotated[Path, "folder of README.md, paper and docs"] = Path("."),
    write: Annotated[bool, "fill in the numbers that README.md and the paper show"] = False,
) -> int:
    """Print every number and every conclusion of the documents, computed from the results.

    Exit status: 0, 1 where a conclusion does not hold, a name is unknown or a number of README.md or the paper differs,
    2 for bad input.
    """
    from bench.reporting.documents import documents, problems, rewritten
    from bench.reporting.sentences import facts
    from bench.reporting.whole_file import write as write_file

    known, pages = facts(folder("results", results)), documents(folder("root", root))
    for name, text in known.numbers.items():
        print(f"{name} = {text.strip()}")
    for name, holds in known.conclusions.items():
        print(f"{name}: {'holds' if holds else 'DOES NOT HOLD'}")
    wrong = [f"{path}: {problem}" for path, text in pages.items() for problem in problems(text, known)]
    for path, text in pages.items():
        new = rewritten(text, known)
        if new != text and write:
            write_file(path, new, field="root")
            print(f"{path}: written", file=sys.stderr)
        elif new != text:
            wrong.append(f"{path}: a number differs: write=true fills it in")
    print(*wrong, f"{sum(known.conclusions.values())} of {len(known.conclusions)} conclusions hold", sep="\n")
    return 1 if wrong else 0


def audits(
    claims: Annotated[Path, "folder of claims"] = Path("claims"),
    results: Annotated[Path, "folder of Tables 2 to 5, whose verdicts stand beside the paper's numbers"] = RESULTS,
    out: Out = RESULTS,
) -> int:
    """Write the audits of published claims as one page and one file of numbers."""
    from bench.audit.evidence import audit
    from bench.commands.audit import read
    from bench.reporting.audits import audit_files
    from bench.reporting.whole_file import check_folder

    stated = [read(path) for path in sorted(folder("claims", claims).glob("*.yaml"))]
    check_folder(out)
    _write(audit_files([audit(claim) for claim in stated], results), out, out)
    return 0


def everything(store: StoreFolder = OWN, archive: ArchiveFolder = None) -> int:
    """Write tables, figures and audits into results/, and fill the numbers of the documents in."""
    tables(store, archive)
    figures(store, archive)
    audits()
    return claims(write=True)


VARIANTS = {
    "what=tables": tables, "what=frame": frame, "what=figures": figures, "what=claims": claims,
    "what=audits": audits, "what=all": everything,
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
    stale = [
        (one.cell.version, one.stored.version) for one in unique if one.state == "stale" and one.cell and one.stored
    ]
    if stale:
        now, then = stale[0]
        cells = f"{len(stale)} of {len(unique)} cells are stale ({now.changed_since(then)[:100]})"
        remedy = f"python -m bench -m experiment={frame.experiment} computes them again"
        print(f"{frame.experiment}: {cells}; {remedy}", file=sys.stderr)
