"""Run the examples of the documents as a reader would; as a program, write what they print and draw into their pages.

``python tests/docs/examples.py docs/gallery/*.md`` runs each page in an empty folder and refreshes its blocks of output
and its pictures.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator, Sequence
from difflib import SequenceMatcher
from pathlib import Path

from pages import BLOCK, REPOSITORY, Block, agree, blocks

PICTURE = re.compile(r"^!\[[^\]]*\]\((?P<name>[^)/]+)\)$", re.MULTILINE)
"""A picture that an example draws: it has no folder."""
SESSION = """
import contextlib, io, json, subprocess, sys

if __name__ == "__main__":
    names = {"__name__": "__main__"}
    for line in sys.stdin:
        language, code = json.loads(line)
        printed = io.StringIO()
        if language == "python":
            with contextlib.redirect_stdout(printed):
                exec(code, names)
        else:
            done = subprocess.run(["bash", "-ec", code], stdout=subprocess.PIPE, text=True, check=True)
            printed.write(done.stdout)
        print(json.dumps(printed.getvalue()), flush=True)
"""
"""One Python for all blocks of a page: names stay defined, as in a notebook."""


def run(page: Path, folder: Path) -> Iterator[tuple[Block, str]]:
    """Run the blocks of a page in order, in one session.

    A block with a title is written to a file. ``sh`` marks code that is not run because it needs a reader's own data,
    ``txt`` output that differs from run to run. Linked programs are copied to the folder, as a reader would save them.
    ``pip install -e .`` is replaced by writing the metadata of the project, so that no index is needed.

    Args:
        page: a page of the documents.
        folder: an empty folder, in which the blocks are run.

    Yields:
        Each block, with the output of the last code up to it.
    """
    for link in re.findall(r"\]\(([^)]+\.py)\)", page.read_text(encoding="utf-8")):
        shutil.copy(page.parent / link, folder)
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    python_path = os.pathsep.join([str(folder), str(REPOSITORY), os.environ.get("PYTHONPATH", "")])
    settings = {"PATH": path, "PYTHONPATH": python_path, "PYTHONDONTWRITEBYTECODE": "1", "COLUMNS": "80"}
    environment = {**os.environ, **settings, "MPLBACKEND": "agg", "NO_COLOR": "1"}
    with (folder / "errors.txt").open("w+", encoding="utf-8") as errors, subprocess.Popen(
        [sys.executable, "-c", SESSION], cwd=folder, env=environment, text=True,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors,
    ) as session:  # fmt: skip
        printed = ""
        for block in blocks(page):
            if block.title:
                (folder / block.title).write_text(block.code, encoding="utf-8")
            elif block.language in ("bash", "python"):
                code = block.code
                if "pip install -e ." in code:
                    _register(folder)
                    code = code.replace("python -m pip install -e .", "true")
                session.stdin.write(json.dumps([block.language, code]) + "\n")
                session.stdin.flush()
                answer = session.stdout.readline()
                errors.seek(0)
                assert answer, f"{page.name}:\n{block.code}\n{errors.read()}"
                printed = json.loads(answer)
            yield block, printed
        session.stdin.close()


def _register(folder: Path) -> None:
    """Write the metadata that an installer writes for the project in a folder."""
    project = tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    info = folder / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n")
    groups = (
        f"[{group}]\n" + "".join(f"{name} = {value}\n" for name, value in points.items())
        for group, points in project["entry-points"].items()
    )
    (info / "entry_points.txt").write_text("\n".join(groups))


def pictures(page: Path) -> list[str]:
    """Return the names of the pictures that a page's own code draws."""
    return PICTURE.findall(page.read_text(encoding="utf-8"))


def refresh(page: Path) -> None:
    """Run a page and write its outputs and pictures anew, where they differ."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        outputs = [(block, printed) for block, printed in run(page, folder)]
        fresh = iter(outputs)

        def rewritten(match: re.Match[str]) -> str:
            block, printed = next(fresh)
            if block.language not in ("text", "txt") or (block.code and agree(block.code, printed, 0.0)):
                return match[0]
            return f"```{block.language}\n{excerpt(block.code, printed)}```"

        text = page.read_text(encoding="utf-8")
        page.write_text(BLOCK.sub(rewritten, text), encoding="utf-8")
        for name in pictures(page):
            (page.parent / name).write_bytes((folder / name).read_bytes())


def excerpt(shown: str, printed: str) -> str:
    """Cut what was printed as an older output was cut: ``...`` replaces the lines between its parts.

    Each part keeps its number of lines, and begins at the line that is most like its first one.
    """
    lines, position = [line.rstrip() for line in printed.strip("\n").splitlines()], 0
    parts = [part.strip("\n").splitlines() for part in re.split(r"(?m)^\.\.\.$", shown)]
    if len(parts) == 1:
        return "\n".join(lines) + "\n"
    result = []
    for number, part in enumerate(parts):
        if not part:
            result.append([])
            continue
        likeness = [SequenceMatcher(None, part[0], line).ratio() for line in lines[position:]]
        first = position + (likeness.index(max(likeness)) if number else 0)
        position = first + len(part)
        result.append(lines[first:position])
    return "\n...\n".join("\n".join(part) for part in result).strip("\n") + "\n"


def main(names: Sequence[str]) -> None:
    """Refresh the pages of the command line."""
    for name in names:
        print(name, flush=True)
        refresh(Path(name).resolve())


if __name__ == "__main__":
    main(sys.argv[1:])
