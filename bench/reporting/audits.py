"""The audits of published claims as one page and one file of numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from bench.audit.evidence import Audit, AuditFinding
from bench.audit.sentences import VERDICTS, lines_of, off, percentage, reported, summary
from bench.reporting.frame import Line
from bench.reporting.labels import counterparts
from bench.reporting.paper import printed
from bench.reporting.rounding import number
from bench.reporting.tables.render import MISSING, Columns, Rows, files, listing

PAPER = "karkadakattil2026"
"""The claim whose numbers stand beside this project's replicates, in Tables 2 to 5."""
PAGE = """# Audits of published claims

What the data of a published claim allow, by `python -m bench audit claims/<name>.yaml`
([how](../docs/how_to/audit_claim.md)). An audit says where a number falls among the scores of an efficient estimator on
data as they are described; it says nothing of an author, and a number may be better or worse by chance.

{verdicts}"""
COLUMNS: Columns[AuditFinding] = {
    "method": lambda f: f.row.method,
    "quantity": lambda f: f.row.quantity.replace("*", r"\*"),
    "case": lambda f: ", ".join(filter(None, [f.row.case, f.row.place])) or MISSING,
    "reported": reported,
    "error": lambda f: off(f) if f.score >= 0 else MISSING,
    "bound": lambda f: number(f.bound) if 0 < f.bound < float("inf") else MISSING,
    "efficient: median (95 %)": lambda f: f"{f.median:.2g} ({f.low:.2g} to {f.high:.2g})" if f.low >= 0 else MISSING,
    "as large": lambda f: percentage(f.larger) if f.larger >= 0 else MISSING,
    "stated sd": lambda f: f"{f.sd_ratio:.2g} bounds" if f.sd_ratio else MISSING,
    "verdict": lambda f: f.verdict,
}


def says(audit: Audit) -> str:
    """Write the first number of a claim, and how many more there are."""
    first, more = audit.of("")[0], len(audit.of("")) - 1
    true = "" if math.isnan(first.truth) else f" ({first.truth:.6g} is true)"
    equal = "" if first.row.value is None or first.row.form != "value" else "= "
    return f"{first.row.method}: {first.row.quantity} {equal}{reported(first)}{true}{f'; {more} more' if more else ''}"


def answer(audit: Audit) -> str:
    """Write what the data allow of the first number of a claim."""
    first = audit.of("")[0]
    texts = {
        "smaller": f"an efficient estimator is as near in {percentage(first.smaller)} of draws",
        "not identifiable": "they do not determine it",
        "bias only": f"{off(first)} is bias: no noise",
        "no number": f"bound {number(first.bound)}",
    }
    if first.verdict in ("within", "larger"):
        return f"an efficient estimator is as far off in {percentage(first.larger)} of draws"
    return texts.get(first.verdict, first.verdict)


OVERVIEW: Columns[Audit] = {
    "claim": lambda a: f"[{a.stated.name}](#{a.stated.name})",
    "says": says,
    "what its data say of that": answer,
    "all numbers": summary,
    "published data": lambda a: (
        ("agree" if all(c.agrees for _, c in a.consistency) else "differ") if a.consistency else MISSING
    ),
}


def audit_files(audits: Sequence[Audit], results: Path) -> dict[str, str]:
    """Return the page and its numbers by name; ``results`` has Tables 2 to 5, with the verdicts of our replicates."""
    verdicts = "\n".join(f"- *{verdict}*: {meaning}" for verdict, meaning in VERDICTS.items())
    parts: list[str | Rows] = [
        PAGE.format(verdicts=verdicts),
        listing([audit for audit in audits if audit.findings], OVERVIEW),
    ]
    lines: list[Line] = []
    for audit in audits:
        source, stated = audit.stated.claim.source, audit.of("")
        ours = dict(zip(map(id, stated), paper_verdicts(results), strict=True)) if audit.stated.name == PAPER else {}
        columns: Columns[AuditFinding] = {**COLUMNS, "other readings": audit.others}
        if ours:
            columns = {**columns, "beside our replicates": lambda f, ours=ours: ours[id(f)]}  # type: ignore[misc]
        said = lines_of(audit, numbers=False)
        parts += [
            f"## {audit.stated.name}",
            f"{source.authors} ({source.year}), [{source.title}]({source.url}); {source.place}.",
            listing(stated, {head: text for head, text in columns.items() if {*map(text, stated)} - {"", MISSING}}),
            "\n".join(f"- {line[0].upper()}{line[1:].rstrip('.')}." for line in said),
        ]  # fmt: skip
        for finding in audit.findings:
            values = {k: v for k, v in vars(finding).items() if k not in ("row", "why")}
            row = finding.row.model_dump(include={"method", "quantity", "case", "form", "draws", "value", "place"})
            lines.append({"claim": audit.stated.name, **row, **values, "replicates": ours.get(id(finding), "")})
    return files("audits", [*parts, "Regenerate: `python -m bench tables what=audits`."], lines, digits=5)


def paper_verdicts(results: Path) -> list[str]:
    """Return the verdicts of our replicates on the paper's numbers, in its order, from Tables 2 to 5."""
    data = pd.concat([pd.read_csv(results / f"table{table}.csv", low_memory=False) for table in (2, 3, 4, 5)])
    data = data[data.initial_state.eq("known") & data.verdict.notna()]
    keys = zip(data.table, data.row.astype(str), data.method, data.metric, strict=True)
    verdicts = dict(zip(keys, data.verdict, strict=True))
    return [verdicts[p.table, p.row, counterparts(p.method)[0], p.metric] for p in printed()]
