"""The documents, their code blocks, and what they show of a program's output beside what it printed."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

REPOSITORY = Path(__file__).parents[2]
OF_THE_ROOT = ("README.md", "CONTRIBUTING.md", "SECURITY.md", "results/README.md")
DOCUMENTS = sorted({REPOSITORY / path for path in OF_THE_ROOT} | set((REPOSITORY / "docs").rglob("*.md")))
BLOCK = re.compile(
    r"^```(?P<language>\w+)(?: title=\"(?P<title>[^\"]+)\")?\n(?P<code>.*?)^```", re.DOTALL | re.MULTILINE
)
NUMBER = re.compile(r"(?<![A-Za-z_])-?\d+(?:\.\d+)?(?:e-?\d+)?")


@dataclass(frozen=True)
class Block:
    """A block of code: ``bash`` and ``python`` to run, ``text`` as printed; with a title, the content of that file."""

    language: str
    title: str
    code: str


def name(path: Path) -> str:
    return path.relative_to(REPOSITORY).as_posix()


def blocks(path: Path) -> list[Block]:
    """The blocks of a document, in order."""
    found = BLOCK.finditer(path.read_text(encoding="utf-8"))
    return [Block(one["language"], one["title"] or "", one["code"]) for one in found]


def titled(path: Path, title: str) -> str:
    """What the block of that title puts into the file of that name."""
    (found,) = [block.code for block in blocks(path) if block.title == title]
    return found


def commands(block: Block) -> Iterator[str]:
    """The command lines of a block, continued ones joined, comments left out, chains and pipes parted."""
    code = re.sub(r"\\\n", " ", block.code)
    code = re.sub(r"&&\s*\n", "&& ", code)
    for line in code.splitlines():
        for part in re.split(r"&&|\|(?!\|)", re.sub(r"(?:^|\s)#.*", "", line)):
            if part.strip():
                yield part.strip()


def agree(shown: str, printed: str, tolerance: float = 0.1) -> bool:
    """Whether a text shows what was printed: word by word, numbers within a tolerance, ``...`` for anything."""
    parts = [part.split() for part in re.split(r"(?m)^\.\.\.$", shown)]
    words, place = printed.split(), 0
    for i, part in enumerate(parts):
        last = len(words) - len(part)
        starts = [place] if i == 0 else [last] if i == len(parts) - 1 and part else range(place, last + 1)
        found = next((at for at in starts if _same(part, words[at : at + len(part)], tolerance)), None)
        if found is None:
            return False
        place = found + len(part)
    return not parts[-1] or place == len(words)


def _same(shown: list[str], printed: list[str], tolerance: float) -> bool:
    return len(shown) == len(printed) and all(_alike(a, b, tolerance) for a, b in zip(shown, printed, strict=True))


def _alike(shown: str, printed: str, tolerance: float) -> bool:
    if re.fullmatch(r"[-|:]+", shown):
        return re.fullmatch(r"[-|:]+", printed) is not None
    if NUMBER.sub("#", shown) != NUMBER.sub("#", printed):
        return False
    pairs = zip(NUMBER.findall(shown), NUMBER.findall(printed), strict=True)
    return all(abs(float(a) - float(b)) <= tolerance * max(abs(float(a)), abs(float(b))) for a, b in pairs)
