"""Build a site with mkdocs in one step: it replaces an older site as a whole, or not at all."""

from __future__ import annotations

import logging
import os
import re
from collections.abc import Iterable, Iterator
from importlib.resources import as_file, files
from pathlib import Path
from tempfile import TemporaryDirectory

from bench.errors import InputError
from bench.reporting import whole_file
from bench.reporting.page.site import NAV

MARKS = ("index.html", "assets", "data")
"""Files of every site; a folder without them is not replaced, unless it is empty."""
SHOWN = (".md", ".csv", ".gz", ".png")
OUTSIDE = re.compile(r"\[([^\]]*)\]\((\.\./|archive|README)[^)]*\)")
"""Link in a table to a file that is not part of the site."""


def check_folder(out: Path) -> None:
    """Raise InputError, before any work, if a folder must not be replaced or cannot be written."""
    other = out.is_dir() and any(out.iterdir()) and not all((out / name).exists() for name in MARKS)
    if out.is_file() or other:
        raise InputError("out", out, "a folder that is new, empty, or a site that this command wrote")
    whole_file.check_folder(out)


def results_files(folder: Path) -> Iterator[tuple[str, bytes]]:
    """Yield the tables and figures of a folder with their paths in the site; HTML in tables is escaped."""
    for path in sorted([*folder.glob("*"), *folder.glob("figures/*.png")]):
        if path.is_file() and path.suffix in SHOWN and path.name != "README.md":
            content = path.read_bytes()
            if path.suffix == ".md":
                text = re.sub(r"<(?=[A-Za-z/!?])", "&lt;", content.decode())
                content = OUTSIDE.sub(r"\1", text).encode()
            yield f"results/{path.relative_to(folder).as_posix()}", content


def write_site(out: Path, pages: Iterable[tuple[str, bytes]]) -> None:
    """Build pages and their files into a folder and replace its contents; raises InputError if that fails."""
    from mkdocs.commands.build import build
    from mkdocs.config import load_config

    os.environ.setdefault("NO_MKDOCS_2_WARNING", "1")
    logging.getLogger("mkdocs").setLevel(logging.ERROR)
    settings = as_file(files("bench.reporting.page") / "mkdocs.yml")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with (
            TemporaryDirectory(prefix=f".{out.name}.", suffix=".tmp", dir=out.parent.resolve()) as work,
            settings as shared,
        ):
            docs, new, old = (Path(work, name) for name in ("docs", "new", "old"))
            for name, content in pages:
                (docs / name).parent.mkdir(parents=True, exist_ok=True)
                (docs / name).write_bytes(content)
            tables = [path.relative_to(docs).as_posix() for path in sorted(docs.glob("results/*.md"))]
            nav = [*({title: page} for title, page in NAV.items()), *[{"Tables": tables}] * bool(tables)]
            config = load_config(str(shared), docs_dir=str(docs), site_dir=str(new), nav=nav)
            config.plugins.on_startup(command="build", dirty=False)
            build(config)
            config.plugins.on_shutdown()
            if out.exists():
                os.replace(out, old)
            os.replace(new, out)
    except OSError as error:
        raise InputError("out", out, f"cannot be written ({error.strerror}); name another folder") from None
