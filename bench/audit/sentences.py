"""An audit in words: what the data allow, never what an author is. Each sentence says no more than its condition."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from bench.audit.evidence import Audit, AuditFinding, Consistency

ERRORS = {"value": "error", "percent error": "error in %", "absolute error": "error", "rmse": "root mean square error"}
VERDICTS = {
    "within": "an error as an efficient estimator has it",
    "larger": "an efficient estimator has so large an error in fewer than 1 % of draws",
    "smaller": "an efficient estimator has so small an error in fewer than 1 % of draws",
    "decided by the prior": "more than half of the bound's variance comes from the prior",
    "not identifiable": "the data do not determine the quantity",
    "bias only": "the data have no noise, so that the error is bias",
    "known beforehand": "the quantity follows from what was known",
    "no number": "none is stated here; the bound is",
}
"""Each verdict with its meaning."""
FIRST_ORDER = 0.2
"""A bound over the value above which its first order in the noise may be off."""
BADGE = """<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="20" role="img" aria-label="audit: {text}">
<rect width="{width}" height="20" rx="3" fill="#555"/><rect x="44" width="{right}" height="20" rx="3" fill="{colour}"/>
<g fill="#fff" font-family="Verdana,DejaVu Sans,sans-serif" font-size="11"><text x="7" y="14">audit</text>
<text x="51" y="14" textLength="{length}">{text}</text></g></svg>
"""


def percentage(share: float) -> str:
    """Write a share of simulated draws."""
    return "0.01 % or fewer" if share < 1e-4 else f"{100 * share:.2g} %" if share < 0.995 else "99 % or more"


def reported(finding: AuditFinding) -> str:
    """Write a number as it was reported."""
    row = finding.row
    if row.value is None:
        return "no number"
    many = f" (mean of {row.draws} draws)" if row.draws > 1 else ""
    return f"{'' if row.form == 'value' else row.form + ' '}{row.value:.6g}{many}"


def off(finding: AuditFinding) -> str:
    """Write a reported error: of a value in percent of the true one."""
    relative = finding.score * (100.0 / abs(finding.truth) if finding.row.form == "value" else 1.0)
    return f"{relative:.2g}{'' if finding.row.form in ('rmse', 'absolute error') else ' %'}"


def placed(finding: AuditFinding) -> str:
    """Write where a reported number falls among the scores of an efficient estimator."""
    row, error = finding.row, ERRORS[finding.row.form]
    if finding.verdict == "not identifiable":
        return "the data do not determine it"
    if finding.verdict == "known beforehand":
        return "it follows from what was known, so that the samples decide nothing"
    if finding.verdict == "bias only":
        return f"off by {off(finding)}, which is bias: there is no noise"
    whose = "on one draw" if row.draws == 1 else f"as a mean of {row.draws} draws"
    spread = (
        f"the bound is {finding.bound:.3g}; an efficient estimator's {error} {whose} has a median of "
        f"{finding.median:.2g} and is between {finding.low:.2g} and {finding.high:.2g} in 95 %"
    )
    ends = {
        "no number": "",
        "decided by the prior": f", most of it by the prior; {finding.score:.2g} says how near that was",
        "within": f"; {percentage(finding.larger)} of draws give at least {finding.score:.2g}",
        "smaller": f"; only {percentage(finding.smaller)} of draws give at most {finding.score:.2g}: more was known "
        "than is stated here, or it is luck",
        "larger": f"; only {percentage(finding.larger)} of draws give at least {finding.score:.2g}: the estimate is "
        "not efficient, the data are not as stated here, or it is chance",
    }
    return spread + ends[finding.verdict]


def given(finding: AuditFinding) -> list[str]:
    """Say what a prior, a starting value and a stated standard deviation amount to."""
    lines = []
    if finding.prior_share > 0:
        lines.append(f"{percentage(finding.prior_share)} of the bound's variance is the prior's")
    if finding.start is not None:
        nearer = ", nearer than where it ended" if finding.start * finding.bound < finding.score else ""
        lines.append(f"the search began {finding.start:.2g} bounds from the stated value{nearer}")
    if finding.sd_ratio is not None:
        lines.append(f"the stated standard deviation is {finding.sd_ratio:.2g} times the bound")
    if FIRST_ORDER * abs(finding.truth) < finding.bound < float("inf"):
        lines.append("so large a bound is a rough one, to first order in the noise")
    return lines


def agreement(case: str, found: Consistency) -> str:
    """Say whether published samples, or a published solution, agree with the stated equation."""
    where, s = f"{case}: " if case else "", "" if found.what == "samples" else "s"
    largest = f"{100 * found.difference:.2g} % of the largest value"
    chance = (
        ""
        if found.chance is None
        else f"; noise of the stated size departs as far in {percentage(found.chance)} of draws"
    )
    if found.agrees:
        return f"{where}the published {found.what} agree{s} with the stated equation: within {largest}{chance}"
    values = ", ".join(f"{name} {fit:.4g} where {stated:g} is stated" for name, (fit, stated) in found.fitted.items())
    return (
        f"{where}the published {found.what} differ{s} from the stated equation by up to {largest}{chance}; what fits "
        f"best, within {100 * found.remaining:.2g} %, has {values}"
    )


def compared(rivals: tuple[AuditFinding, ...]) -> str:
    """Say between which methods the draws do not decide, and which are outside an efficient estimator's range."""
    row = rivals[0].row
    near, far = (
        list(dict.fromkeys(f"'{f.row.method}'" for f in rivals if (f.verdict == "larger") == large))
        for large in (False, True)
    )
    within, outside = " and ".join(near), " and ".join(far)
    where = f"for {', '.join(filter(None, [row.quantity, row.case, row.place]))}"
    if not within:
        return f"{where}: the errors of {outside} are larger than an efficient estimator's; noise does not order them"
    draws = "one draw does" if row.draws == 1 else f"{row.draws} draws do"
    open_ = f"{draws} not decide which is nearer to the truth, {within}"
    said = open_ if len(near) > 1 else f"{within} has an error as an efficient estimator may have it"
    return f"{where}: {said}{f'; the errors of {outside} are larger' if outside else ''}"


def summary(audit: Audit) -> str:
    """Count the verdicts as stated, and say whether the data are consistent."""
    verdicts = [finding.verdict for finding in audit.of("")]
    counts = [f"{verdicts.count(verdict)} {verdict}" for verdict in dict.fromkeys(VERDICTS) if verdict in verdicts]
    differ = not all(found.agrees for _, found in audit.consistency)
    return ", ".join([*counts, *(["data and equation differ"] if differ else [])]) or "nothing reported"


def lines_of(audit: Audit, numbers: bool = True) -> list[str]:
    """Return the audit as sentences, in the order in which they are read; those on each number can be left out."""
    claim, lines = audit.stated.claim, [agreement(case, found) for case, found in audit.consistency]
    for finding in audit.of("") if numbers else ():
        row, others = finding.row, audit.others(finding)
        name = ", ".join(filter(None, [row.method, row.quantity, row.case, row.place]))
        also = [f"under other readings: {others}"] if others else []
        lines.append("; ".join([f"{name}, {reported(finding)}: {placed(finding)}", *given(finding), *also]))
    lines += ["; ".join(why) for why in dict.fromkeys(finding.why for finding in audit.of("") if finding.why)]
    lines += map(compared, audit.rivals)
    return lines + [f"assumed: {text}" for text in claim.assumed] + [f"missing: {text}" for text in claim.missing]


def paragraph(audit: Audit) -> str:
    """Return a paragraph that can be cited."""
    source = audit.stated.claim.source
    place = f", {source.place}" if source.place else ""
    begin = f"{source.authors} ({source.year}), {source.title}{place}, {source.url}."
    return " ".join([begin, *(f"{line[0].upper()}{line[1:].rstrip('.')}." for line in lines_of(audit))])


def badge(audit: Audit) -> str:
    """Return the summary as a small picture (SVG)."""
    text = summary(audit)
    length, colour = 6 * len(text), "#a60" if "differ" in text else "#357"
    return BADGE.format(width=length + 58, right=length + 14, length=length, text=text, colour=colour)


def as_dict(audit: Audit) -> dict[str, Any]:
    """Return the audit as JSON holds it."""
    claim = audit.stated.claim
    return {
        "claim": audit.stated.name, "source": claim.source.model_dump(), "summary": summary(audit),
        "findings": [{**asdict(finding), "row": finding.row.model_dump()} for finding in audit.findings],
        "comparisons": [compared(rivals) for rivals in audit.rivals],
        "consistency": [{"case": case, "agrees": found.agrees, **asdict(found)} for case, found in audit.consistency],
        "assumed": claim.assumed, "missing": claim.missing, "paragraph": paragraph(audit),
    }  # fmt: skip
