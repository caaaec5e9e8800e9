"""The verb ``tables``: tables, figures and numbers from stored cells, and audits of published claims."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from bench.commands.declaration import folder
from bench.commands.log import LOG
from bench.commands.stores import DEFAULT, ArchiveFolder, StoreFolder, named_store
from bench.errors import InputError

if TYPE_CHECKING:
    from bench.reporting.frame import Frame

RESULTS, TEX, FIGURES = Path("results"), Path("build/tables"), Path("results/figures")
Out = Annotated[Path, "folder of the files"]


def tables(
    store: StoreFolder = DEFAULT,
    archive: ArchiveFolder = None,
    out: Out = RESULTS,
    tex: Annotated[Path, "folder of the LaTeX tables"] = TEX,
) -> int:
    """Write the tables of all experiments as Markdown, CSV and LaTeX; what=frame, figures, claims, ...

    Nothing is computed. The experiments of conf/experiment describe the tables; a missing cell is marked as missing. A
    submitted method appears, marked, in the tables of which it has every scenario.
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
            LOG.warning("%s: no cells stored; run python -m bench -m experiment=%s", name, name)
        written += _write(files, out, tex)
    if not written:
        raise InputError("store", store, "none of its cells belongs to a table; see python -m bench status")
    return 0


def frame(
    experiment: Annotated[str | None, "print the rows of this experiment instead [none]"] = None,
    metric: Annotated[str, "metric of the rows that are printed"] = "k_over_m_error_pct",
    store: StoreFolder = DEFAULT,
    archive: ArchiveFolder = None,
    out: Annotated[Path, "file of the frame"] = Path("build/frame.parquet"),
) -> int:
    """Write all that tables show as one Parquet file: one row per cell and metric, with ties, verdicts and states."""
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
    print(f"{out}: {len(data)} rows")
    return 0


def figures(
    store: StoreFolder = DEFAULT,
    archive: ArchiveFolder = None,
    out: Out = FIGURES,
    svg: Annotated[Path | None, "folder of the figures as SVG [none]"] = None,
) -> int:
    """Draw the figures as PNG files with captions; figures without cells are left out."""
    from bench.reporting.pictures.all_pictures import PICTURES
    from bench.reporting.pictures.gallery import Gallery
    from bench.reporting.pictures.style import Nothing, save
    from bench.reporting.whole_file import check_folder

    opened = named_store(store, archive, filled=True)
    check_folder(out)
    if svg is not None:
        check_folder(svg, "svg")
    gallery, drawn = Gallery(opened), 0
    for name, draw in PICTURES.items():
        try:
            paths = save(draw(gallery), out, svg)
        except Nothing as reason:
            LOG.warning("%s: not drawn: %s", name, reason)
            continue
        drawn += 1
        print(*paths, sep="\n")
    if not drawn:
        raise InputError("store", store, "no cell has the data of a figure; run experiment=table5")
    return 0


def claims(
    results: Annotated[Path, "folder of tables and of the archive"] = RESULTS,
    root: Annotated[Path, "folder of README.md, paper and docs"] = Path("."),
    write: Annotated[bool, "update the numbers in README.md and the paper"] = False,
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
            LOG.info("%s: written", path)
        elif new != text:
            wrong.append(f"{path}: a number differs; write=true updates it")
    print(*wrong, f"{sum(known.conclusions.values())} of {len(known.conclusions)} conclusions hold", sep="\n")
    return 1 if wrong else 0


def audits(
    claims: Annotated[Path, "folder of claims"] = Path("claims"),
    results: Annotated[Path, "folder of Tables 2 to 5, which have the verdicts on the paper's numbers"] = RESULTS,
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


def everything(store: StoreFolder = DEFAULT, archive: ArchiveFolder = None) -> int:
    """Write tables, figures and audits to results/, and update the numbers of the documents."""
    tables(store, archive)
    figures(store, archive)
    audits()
    return claims(write=True)


VARIANTS = {
    "what=tables": tables, "what=frame": frame, "what=figures": figures, "what=claims": claims,
    "what=audits": audits, "what=all": everything,
}  # fmt: skip


def _write(files: Mapping[str, str], out: Path, tex: Path) -> int:
    """Write files by name and print their paths; return their number."""
    from bench.reporting.whole_file import write

    for name, content in files.items():
        place = tex if name.endswith(".tex") else out
        write(place / name, content, place)
        print(place / name)
    return len(files)


def _warn_if_stale(frame: Frame) -> None:
    """Warn where a table contains cells of another version."""
    unique = {result.identity: result for result in frame}.values()
    stale = [(r.cell.version, r.stored.version) for r in unique if r.state == "stale" and r.cell and r.stored]
    if stale:
        now, then = stale[0]
        cells = f"{len(stale)} of {len(unique)} cells are stale ({now.changed_since(then)[:100]})"
        remedy = f"python -m bench -m experiment={frame.experiment} computes them again"
        LOG.warning("%s: %s; %s", frame.experiment, cells, remedy)
