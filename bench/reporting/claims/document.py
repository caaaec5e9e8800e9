"""Documents with claims in them: passages between two comments, filled in; and numbers that stand outside."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from bench.errors import InputError
from bench.reporting.claims import (
    atlas,
    atlas_forced,
    family,
    free_decay,
    off_table,
    online,
    paper,
    studies,
    systems,
    wider,
)
from bench.reporting.claims.allowed import ALLOWED, allowed_in
from bench.reporting.claims.claim import Claim, Said
from bench.reporting.claims.evidence import Evidence
from bench.reporting.claims.panels import PANEL, with_panels

SECTIONS: Mapping[str, Sequence[Claim]] = {
    "overview": wider.OVERVIEW,
    "archive": wider.ARCHIVE,
    "free decay": free_decay.CLAIMS,
    "cost": wider.COST,
    "broken assumptions": wider.BROKEN,
    "wrong models": off_table.WRONG,
    "open split": off_table.OPEN,
    "engine": studies.ENGINE,
    "family": family.CLAIMS,
    "systems": systems.CLAIMS,
    "reach": studies.REACH,
    "measured": studies.MEASURED,
    "online": online.CLAIMS,
    "atlas": atlas.CLAIMS,
    "atlas_forced": atlas_forced.CLAIMS,
    "paper": paper.CLAIMS,
}
"""The passages of the documents by the name in their comment: ``<!-- claims: cost -->`` to ``<!-- /claims -->``."""
PASSAGE = re.compile(r"(<!-- claims: (?P<name>[\w ]+) -->\n)(?P<text>(?:(?!<!--).)*?)\n?(<!-- /claims -->)", re.DOTALL)
PAGES = ("README.md", "paper/*.md", "docs/**/*.md", "results/README.md")
"""Where prose about results stands, below the folder that holds ``results``."""
SET_ASIDE = (
    re.compile(r"\A---\n.*?\n---\n", re.DOTALL),
    re.compile(r"<!-- claims: .*?<!-- /claims -->", re.DOTALL),
    PANEL,
    re.compile(r"```.*?```", re.DOTALL),
    re.compile(r"`[^`\n]*`"),
    re.compile(r"\]\([^)]*\)"),
    re.compile(r"\[@[^\]]*\]"),
    re.compile(r"^ *\d+\. ", re.MULTILINE),
)
"""What of a document is not prose: header, claims, tables, code, addresses, citations, the numbers of a list."""
WORDS = (
    r"\b(?:eleven|twelve|(?:thir|four|fif|six|seven|eigh|nine)teen|twenty|thirty|forty|fifty|sixty|seventy|eighty|ninety"
    r"|hundreds?|thousands?|dozens?|tenfold|twice|half|thirds?|quarters?)\b"
)
NUMBER = re.compile(rf"(?<![A-Za-z])\d(?:[\d.,]*\d)?|{WORDS}", re.IGNORECASE)
"""A number in digits, not within a name such as x1, or in one of the words that are not used for anything else."""


@dataclass(frozen=True)
class Document:
    """A page of prose: its path below the folder that holds ``results``, and its text."""

    path: PurePosixPath
    text: str

    @property
    def up(self) -> str:
        """What leads from its folder to the one that holds ``results``: ``../../`` for ``docs/how_to/run.md``."""
        return "../" * (len(self.path.parts) - 1)

    def passages(self) -> dict[str, str]:
        """The text of every passage by name; raises InputError for an unknown one, and for two alike."""
        found: dict[str, str] = {}
        for one in PASSAGE.finditer(self.text):
            name = one["name"]
            if name not in SECTIONS or name in found:
                raise InputError("claims", name, f"the passages are, each once in {self.path}: {', '.join(SECTIONS)}")
            found[name] = one["text"]
        return found

    def typed(self) -> list[str]:
        """Its numbers that belong to no claim and that nothing allows; see :func:`typed`."""
        return typed(self.text, allowed_in(self.path))

    def written(self, checked: Sequence[Checked], results: Path) -> Document:
        """With every passage and every panel of a table as the results have it now."""
        return Document(self.path, with_panels(self.filled(checked).text, results))

    def filled(self, checked: Sequence[Checked]) -> Document:
        """With every passage written anew; one with a claim that nothing is known of stays as it is."""
        texts = {one.claim.name: one.claim.filled(one.said, self.up) for one in checked if one.said is not None}

        def passage(found: re.Match[str]) -> str:
            names = [claim.name for claim in SECTIONS[found["name"]]]
            if not set(names) <= set(texts):
                return found[0]
            return found[1] + "\n".join(texts[name] for name in names) + "\n" + found[4]

        self.passages()
        return Document(self.path, PASSAGE.sub(passage, self.text))


@dataclass(frozen=True)
class Checked:
    """A claim beside what the results say, and whether the documents say the same; None where they cannot tell."""

    claim: Claim
    said: Said | None
    agrees: bool
    problem: str = ""

    @property
    def passes(self) -> bool:
        return self.said is not None and self.agrees and not self.said.broken


def documents(root: Path) -> list[Document]:
    """The pages of prose in a folder; raises InputError without a README.md, and for one that cannot be read."""
    if not (root / "README.md").is_file():
        raise InputError("root", root, "a folder with a README.md; run the command in a clone")
    return [_read(root, path) for path in sorted({path for pattern in PAGES for path in root.glob(pattern)})]


def _read(root: Path, path: Path) -> Document:
    try:
        return Document(PurePosixPath(path.relative_to(root).as_posix()), path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError("root", path, f"cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise InputError("root", path, "not a text in UTF-8") from None


def check(pages: Sequence[Document], evidence: Evidence) -> Iterator[Checked]:
    """Every claim against the results, and against them every page that has its passage: one at least."""
    there = [(page.up, page.passages()) for page in pages]
    for name, claims in SECTIONS.items():
        written = [(up, f"\n{passages[name]}\n") for up, passages in there if name in passages]
        for claim in claims:
            try:
                said = claim.said(evidence)
            except InputError as error:
                yield Checked(claim, None, False, str(error))
            else:
                same = [f"\n{claim.filled(said, up)}\n" in text for up, text in written]
                yield Checked(claim, said, bool(same) and all(same))


def typed(text: str, allowed: Sequence[str] = ALLOWED) -> list[str]:
    """Numbers in prose that belong to no claim and match no allowed pattern, each with the words around it."""
    text = prose(text)
    spans = [found.span() for pattern in allowed for found in re.finditer(pattern, text)]
    outside = (
        found for found in NUMBER.finditer(text) if not any(a <= found.start() and found.end() <= b for a, b in spans)
    )
    return [text[max(0, found.start() - 40) : found.end() + 30].strip() for found in outside]


def prose(text: str) -> str:
    """What of a document is typed by hand, in one line."""
    for pattern in SET_ASIDE:
        text = pattern.sub(lambda found: "\n" * found[0].count("\n") + " ", text)
    return re.sub(r"\s+", " ", text)


def typed_in_claims() -> dict[str, list[str]]:
    """The same of the texts of the claims, by claim: what stands beside their numbers; none where there is none."""
    found = {claim.name: typed(re.sub(r"\{\w+\}", "#", claim.text)) for claims in SECTIONS.values() for claim in claims}
    return {name: numbers for name, numbers in found.items() if numbers}
