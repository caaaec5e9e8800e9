"""Documents with claims in them: passages between two comments, filled in; and numbers that stand outside."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from bench.errors import InputError
from bench.reporting.claims import atlas, atlas_forced, family, free_decay, off_table, online, studies, systems, wider
from bench.reporting.claims.allowed import ALLOWED
from bench.reporting.claims.claim import Claim, Said
from bench.reporting.claims.evidence import Evidence

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
}
"""The passages of README.md by the name in their comment: ``<!-- claims: cost -->`` to ``<!-- /claims -->``."""
PASSAGE = re.compile(r"(<!-- claims: (?P<name>[\w ]+) -->\n)(?P<text>(?:(?!<!--).)*?)\n?(<!-- /claims -->)", re.DOTALL)
PANEL = re.compile(r"(<!-- (?P<table>table \d) -->\n).*?(\n<!-- /(?P=table) -->)", re.DOTALL)
"""A passage that shows what a table of results has for a known start."""
SET_ASIDE = (
    re.compile(r"<!-- claims: .*?<!-- /claims -->", re.DOTALL),
    re.compile(r"<!-- table.*?<!-- /table.*?-->", re.DOTALL),  # panels of the tables, see with_panels
    re.compile(r"```.*?```", re.DOTALL),
    re.compile(r"`[^`\n]*`"),
    re.compile(r"\]\([^)]*\)"),
    re.compile(r"^ *\d+\. ", re.MULTILINE),
)
"""What of a document is not typed prose: claims, tables, code, addresses, the numbers of a list's points."""
WORDS = (
    r"\b(?:eleven|twelve|(?:thir|four|fif|six|seven|eigh|nine)teen|twenty|thirty|forty|fifty|sixty|seventy|eighty|ninety"
    r"|hundreds?|thousands?|dozens?|tenfold|twice|half|thirds?|quarters?)\b"
)
NUMBER = re.compile(rf"(?<![A-Za-z])\d(?:[\d.,]*\d)?|{WORDS}", re.IGNORECASE)
"""A number in digits, not within a name such as x1, or in one of the words that are not used for anything else."""


@dataclass(frozen=True)
class Checked:
    """A claim beside what the results say, and whether the document says the same; None where they cannot tell."""

    claim: Claim
    said: Said | None
    agrees: bool
    problem: str = ""

    @property
    def passes(self) -> bool:
        return self.said is not None and self.agrees and not self.said.broken


def passages(document: str) -> dict[str, str]:
    """The text of every passage by name; raises InputError for one that no claims are known of, and for two alike."""
    found: dict[str, str] = {}
    for one in PASSAGE.finditer(document):
        name = one["name"]
        if name not in SECTIONS or name in found:
            raise InputError("claims", name, "the passages are, each once: " + ", ".join(SECTIONS))
        found[name] = one["text"]
    return found


def check(document: str, evidence: Evidence) -> Iterator[Checked]:
    """Every claim against the results, and the document against what the claim then says."""
    there = passages(document)
    for name, claims in SECTIONS.items():
        for claim in claims:
            try:
                said = claim.said(evidence)
            except InputError as error:
                yield Checked(claim, None, False, str(error))
            else:
                written = f"\n{there.get(name, '')}\n"
                yield Checked(claim, said, f"\n{claim.filled(said)}\n" in written)


def filled(document: str, checked: Sequence[Checked]) -> str:
    """The document with every passage written anew; one with a claim that nothing is known of stays as it is."""
    texts = {one.claim.name: one.claim.filled(one.said) for one in checked if one.said is not None}

    def passage(found: re.Match[str]) -> str:
        names = [claim.name for claim in SECTIONS[found["name"]]]
        if not set(names) <= set(texts):
            return found[0]
        return found[1] + "\n".join(texts[name] for name in names) + "\n" + found[4]

    passages(document)
    return PASSAGE.sub(passage, document)


def with_panels(document: str, results: Path) -> str:
    """The document with every panel as the table in the folder of results has it now; raises InputError without one."""

    def panel(found: re.Match[str]) -> str:
        path = results / f"{found['table'].replace(' ', '')}.md"
        if not path.is_file():
            raise InputError("results", path, "there is no such table; write it with python -m bench.tables")
        known = path.read_text(encoding="utf-8").partition("## Initial state known")[2]
        return found[1] + known.partition("##")[0].strip() + found[3]

    return PANEL.sub(panel, document)


def typed(text: str, allowed: Sequence[str] = ALLOWED) -> list[str]:
    """Numbers in prose that belong to no claim and match no allowed pattern, each with the words around it."""
    for pattern in SET_ASIDE:
        text = pattern.sub(lambda found: "\n" * found[0].count("\n") + " ", text)
    text = re.sub(r"\s+", " ", text)
    spans = [found.span() for pattern in allowed for found in re.finditer(pattern, text)]
    outside = (
        found for found in NUMBER.finditer(text) if not any(a <= found.start() and found.end() <= b for a, b in spans)
    )
    return [text[max(0, found.start() - 40) : found.end() + 30].strip() for found in outside]


def typed_in_claims() -> dict[str, list[str]]:
    """The same of the texts of the claims, by claim: what stands beside their numbers; none where there is none."""
    found = {claim.name: typed(re.sub(r"\{\w+\}", "#", claim.text)) for claims in SECTIONS.values() for claim in claims}
    return {name: numbers for name, numbers in found.items() if numbers}
