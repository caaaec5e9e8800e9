"""An audit in words: what the data allow, never what an author is. Each sentence says no more than its condition."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from bench.audit.evidence import Audit, AuditFinding, Consistency

FORMS = {"value": "error", "percent error": "error in %", "absolute error": "error", "rmse": "root mean square error"}
SHORT = {
    "within": "within the range of an efficient estimator", "smaller": "smaller than expected of the stated data",
    "larger": "larger than expected of an efficient estimator", "not identifiable": "not determined by the data",
    "bias only": "bias only: no noise", "known": "follows from what was known", "no number": "no number is reported",
}  # fmt: skip
FIRST_ORDER = 0.2
"""A bound over the value above which its first order in the noise may be off."""
BADGE = """<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="20" role="img" aria-label="{text}">
<title>{text}</title><rect width="{width}" height="20" rx="3" fill="#555"/>
<rect x="44" width="{right}" height="20" rx="3" fill="{colour}"/>
<g fill="#fff" font-family="Verdana,DejaVu Sans,sans-serif" font-size="11"><text x="7" y="14">audit</text>
<text x="51" y="14" textLength="{length}">{text}</text></g></svg>
"""


def percentage(share: float) -> str:
    """Write a share of simulated draws in percent."""
    return "fewer than 0.01 %" if share < 1e-4 else f"{100 * share:.2g} %" if share < 0.995 else "more than 99 %"


def reported(finding: AuditFinding) -> str:
    """Write a number as it was reported."""
    row = finding.row
    many = f", mean of {row.draws} draws" if row.draws > 1 else ""
    if row.value is None:
        return "not reported"
    return f"{row.value:g}" if row.form == "value" and not many else f"{row.form} {row.value:g}{many}"


def placed(finding: AuditFinding) -> str:
    """Write where a reported number falls among the scores of an efficient estimator."""
    row, unit = finding.row, " %" if finding.row.form == "percent error" else ""
    whose = "one draw" if row.draws == 1 else f"the mean of {row.draws} draws"
    if finding.verdict == "not identifiable":
        return "the data do not determine it"
    if finding.verdict == "known":
        return "it follows from what was known, so that the samples decide nothing"
    if finding.verdict == "bias only":
        off = f"{100 * finding.score / abs(finding.truth):.2g} %" if row.form == "value" else f"{finding.score:g}{unit}"
        return f"off by {off}; without noise there is no spread to compare with, and this is bias alone"
    score = "" if row.value is None else f", {FORMS[row.form]} {finding.score:.3g}"
    spread = f"bound {finding.bound:.3g}{score}; of {whose} an efficient estimator "
    spread += f"has a median {FORMS[row.form]} of {finding.median:.3g} and 95 % between {finding.low:.2g} and "
    spread += f"{finding.high:.3g}"
    if row.value is None:
        return spread
    ends = {
        "within": f"{percentage(finding.larger)} of draws are at least so far off",
        "smaller": f"{percentage(finding.smaller)} of draws are so near: more was known than is stated here, or it is "
        "luck",
        "larger": f"{percentage(finding.larger)} of draws are so far off: the estimate is not efficient, the data are "
        "not as stated here, or it is chance",
    }
    return f"{spread}; {ends[finding.verdict]}"


def given(finding: AuditFinding) -> list[str]:
    """Say what a prior, a starting value and a stated standard deviation amount to."""
    lines = []
    if finding.prior_share > 0:
        lines.append(f"{percentage(finding.prior_share)} of the bound's variance is that of the prior")
    if finding.start is not None:
        nearer = ", nearer than it ended" if finding.start * finding.bound < finding.score else ""
        began = f"{finding.start:.2g} standard deviations of the bound from the stated value{nearer}"
        lines.append(f"the search began {began}")
    if finding.sd_ratio is not None:
        lines.append(f"the stated standard deviation is {finding.sd_ratio:.2g} times the bound")
    if 0 < finding.bound < float("inf") and finding.bound > FIRST_ORDER * abs(finding.truth):
        lines.append("the bound is a large part of the value: to first order in the noise it is a rough one")
    return lines


def agreement(case: str, found: Consistency) -> str:
    """Say whether published samples, or a published solution, agree with the stated equation."""
    where, largest = f"{case}: " if case else "", f"{100 * found.difference:.2g} % of the largest value"
    if found.agrees:
        return f"{where}the published {found.what} agree with the stated equation (within {largest})".replace(
            "solution agree", "solution agrees"
        )
    values = ", ".join(f"{name} {fit:.4g} where {stated:g} is stated" for name, (fit, stated) in found.fitted.items())
    chance = (
        "" if found.chance is None else f"; noise of the stated size does so in {percentage(found.chance)} of draws"
    )
    return (
        f"{where}the published {found.what} differ from the stated equation by up to {largest}{chance}. What fits best "
        f"(within {100 * found.remaining:.2g} %) has {values}"
    ).replace("solution differ", "solution differs")


def compared(audit: Audit) -> list[str]:
    """Say which comparisons of methods are decided."""
    lines = []
    for comparison in audit.comparisons:
        first, *_, last = comparison.findings
        names = " and ".join(dict.fromkeys(f.row.method for f in comparison.findings))
        where = f" ({first.row.case})" if first.row.case else ""
        gap, what = f"{(last.score - first.score) / first.bound:.2g} bounds", first.row.quantity
        of = "one draw does not decide" if first.row.draws == 1 else "these draws do not decide"
        decided = f"{last.row.method} is outside an efficient estimator's range and {first.row.method} is within it"
        open_ = f"{of} which is nearer to the truth"
        lines.append(f"{names}, {what}{where}: {gap} apart; {decided if comparison.decided else open_}")
    return lines


def summary(audit: Audit) -> str:
    """Count the verdicts under the first reading, and say whether the data are consistent."""
    verdicts = [finding.verdict for finding in audit.of("")]
    counts = [f"{verdicts.count(verdict)} {verdict}" for verdict in SHORT if verdict in verdicts]
    inconsistent = not all(c.agrees for checks in audit.consistency.values() for c in checks)
    return ", ".join([*counts, *(["data and equation differ"] if inconsistent else [])])


def lines_of(audit: Audit) -> list[str]:
    """Return the audit as sentences, in the order in which they are read."""
    claim = audit.stated.claim
    lines = [agreement(case, found) for case, checks in audit.consistency.items() for found in checks]
    for number, finding in enumerate(audit.of("")):
        row = finding.row
        name = ", ".join(filter(None, [row.method, row.quantity, row.case, row.place]))
        others = [audit.of(reading)[number] for reading in audit.stated.readings[1:]]
        also = [f"under '{f.reading}' {f.verdict} (bound {f.bound:.3g})" for f in others]
        lines.append("; ".join([f"{name} = {reported(finding)}: {placed(finding)}", *given(finding), *also]))
    lines += ["; ".join(why) for why in dict.fromkeys(finding.why for finding in audit.of("") if finding.why)]
    lines += compared(audit)
    lines += [f"assumed: {text}" for text in claim.assumed] + [f"missing: {text}" for text in claim.missing]
    return lines


def paragraph(audit: Audit) -> str:
    """Return a paragraph that can be cited."""
    source = audit.stated.claim.source
    place = f", {source.place}" if source.place else ""
    begin = f"{source.authors} ({source.year}), {source.title}{place}, {source.url}. "
    return begin + " ".join(f"{line[0].upper()}{line[1:]}." for line in lines_of(audit))


def badge(audit: Audit) -> str:
    """Return the summary as a small picture (SVG)."""
    text = summary(audit)
    length = 6 * len(text)
    colour = "#a60" if "differ" in text else "#357"
    return BADGE.format(width=length + 58, right=length + 14, length=length, text=text, colour=colour)


def as_dict(audit: Audit) -> dict[str, Any]:
    """Return the audit as JSON holds it."""
    stated = audit.stated

    def numbers(finding: AuditFinding) -> dict[str, Any]:
        return {**finding.row.model_dump(), **{k: v for k, v in asdict(finding).items() if k != "row"}}

    return {
        "claim": stated.name, "source": stated.claim.source.model_dump(), "summary": summary(audit),
        "findings": [numbers(finding) for finding in audit.findings],
        "comparisons": [
            {"methods": [f.row.method for f in c.findings], "quantity": c.findings[0].row.quantity,
             "case": c.findings[0].row.case, "decided": c.decided} for c in audit.comparisons
        ],
        "consistency": [
            {"case": case, "agrees": check.agrees, **asdict(check)}
            for case, checks in audit.consistency.items() for check in checks
        ],
        "assumed": stated.claim.assumed, "missing": stated.claim.missing, "paragraph": paragraph(audit),
    }  # fmt: skip
