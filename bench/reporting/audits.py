"""The page of the audits of published claims, and its CSV file."""

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
"""The claim whose numbers Tables 2 to 5 compare with replicates."""
PAGE = """# Audits of published claims

How accurate a published estimate can be, given its data: `python -m bench audit claims/<name>.yaml`
([guide](../docs/how_to/audit_claim.md)). An audit compares a number with the errors of an efficient estimator on data
as the source describes them. It does not judge authors, and a number may be better or worse by chance.

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


def first_number(audit: Audit) -> str:
    """Format the first number of a claim, and the number of others."""
    first, more = audit.of("")[0], len(audit.of("")) - 1
    true = "" if math.isnan(first.truth) else f" (true: {first.truth:.6g})"
    equal = "" if first.row.value is None or first.row.form != "value" else "= "
    return f"{first.row.method}: {first.row.quantity} {equal}{reported(first)}{true}{f'; {more} more' if more else ''}"


def conclusion(audit: Audit) -> str:
    """Format the conclusion on the first number of a claim."""
    first = audit.of("")[0]
    texts = {
        "smaller": f"an efficient estimator is at least as accurate in {percentage(first.smaller)} of draws",
        "not identifiable": "not identifiable from the data",
        "bias only": f"error of {off(first)}, all bias: no noise",
        "no number": f"bound {number(first.bound)}",
    }
    if first.verdict in ("within", "larger"):
        return f"an efficient estimator has at least this error in {percentage(first.larger)} of draws"
    return texts.get(first.verdict, first.verdict)


OVERVIEW: Columns[Audit] = {
    "claim": lambda a: f"[{a.stated.name}](#{a.stated.name})",
    "first number": first_number,
    "given its data": conclusion,
    "all numbers": summary,
    "published data": lambda a: (
        ("agree" if all(c.agrees for _, c in a.consistency) else "differ") if a.consistency else MISSING
    ),
}


def audit_files(audits: Sequence[Audit], results: Path) -> dict[str, str]:
    """Return the files of the page by name; ``results`` has Tables 2 to 5, with the verdicts of the replicates."""
    verdicts = "\n".join(f"- *{verdict}*: {meaning}" for verdict, meaning in VERDICTS.items())
    parts: list[str | Rows] = [
        PAGE.format(verdicts=verdicts),
        listing([audit for audit in audits if audit.findings], OVERVIEW),
    ]
    lines: list[Line] = []
    for audit in audits:
        source, stated = audit.stated.claim.source, audit.of("")
        of_paper = audit.stated.name == PAPER
        replicates = dict(zip(map(id, stated), paper_verdicts(results), strict=True)) if of_paper else {}
        columns: Columns[AuditFinding] = {**COLUMNS, "other readings": audit.others}
        if replicates:
            columns = {**columns, "compared with replicates": lambda f, by_id=replicates: by_id[id(f)]}  # type: ignore[misc]
        sentences = lines_of(audit, numbers=False)
        parts += [
            f"## {audit.stated.name}",
            f"{source.authors} ({source.year}), [{source.title}]({source.url}); {source.place}.",
            listing(stated, {head: text for head, text in columns.items() if {*map(text, stated)} - {"", MISSING}}),
            "\n".join(f"- {line[0].upper()}{line[1:].rstrip('.')}." for line in sentences),
        ]  # fmt: skip
        for finding in audit.findings:
            values = {k: v for k, v in vars(finding).items() if k not in ("row", "why")}
            row = finding.row.model_dump(include={"method", "quantity", "case", "form", "draws", "value", "place"})
            lines.append({"claim": audit.stated.name, **row, **values, "replicates": replicates.get(id(finding), "")})
    return files("audits", [*parts, "Regenerate: `python -m bench tables what=audits`."], lines, digits=5)


def paper_verdicts(results: Path) -> list[str]:
    """Return the verdicts of the replicates on the paper's numbers, in its order, from Tables 2 to 5."""
    data = pd.concat([pd.read_csv(results / f"table{table}.csv", low_memory=False) for table in (2, 3, 4, 5)])
    data = data[data.initial_state.eq("known") & data.verdict.notna()]
    keys = zip(data.table, data.row.astype(str), data.method, data.metric, strict=True)
    verdicts = dict(zip(keys, data.verdict, strict=True))
    return [verdicts[p.table, p.row, counterparts(p.method)[0], p.metric] for p in printed()]
