"""Sentences of an audit, which describe the data and never the author; no sentence exceeds its condition."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from bench.audit.evidence import Audit, AuditFinding, Consistency

ERRORS = {"value": "error", "percent error": "error in %", "absolute error": "error", "rmse": "root mean square error"}
VERDICTS = {
    "within": "an error that is typical of an efficient estimator",
    "larger": "an efficient estimator has an error of at least this size in fewer than 1 % of draws",
    "smaller": "an efficient estimator has an error of at most this size in fewer than 1 % of draws",
    "decided by the prior": "more than half of the bound's variance is due to the prior",
    "not identifiable": "the data do not determine the quantity",
    "bias only": "the data have no noise, so the error is bias",
    "known beforehand": "the quantity follows from known values",
    "no number": "no estimate is stated; only the bound is given",
}
"""Each verdict with its meaning."""
FIRST_ORDER = 0.2
"""Ratio of bound to value above which the bound, of first order in the noise, is a rough one."""
BADGE = """<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="20" role="img" aria-label="audit: {text}">
<rect width="{width}" height="20" rx="3" fill="#555"/><rect x="44" width="{right}" height="20" rx="3" fill="{colour}"/>
<g fill="#fff" font-family="Verdana,DejaVu Sans,sans-serif" font-size="11"><text x="7" y="14">audit</text>
<text x="51" y="14" textLength="{length}">{text}</text></g></svg>
"""


def percentage(share: float) -> str:
    """Format a share of simulated draws."""
    return "0.01 % or fewer" if share < 1e-4 else f"{100 * share:.2g} %" if share < 0.995 else "99 % or more"


def reported(finding: AuditFinding) -> str:
    """Format a number as it was reported."""
    row = finding.row
    if row.value is None:
        return "no number"
    many = f" (mean of {row.draws} draws)" if row.draws > 1 else ""
    return f"{'' if row.form == 'value' else row.form + ' '}{row.value:.6g}{many}"


def off(finding: AuditFinding) -> str:
    """Format a reported error, that of a value in percent of the true one."""
    relative = finding.score * (100.0 / abs(finding.truth) if finding.row.form == "value" else 1.0)
    return f"{relative:.2g}{'' if finding.row.form in ('rmse', 'absolute error') else ' %'}"


def placed(finding: AuditFinding) -> str:
    """Compare a reported number with the errors of an efficient estimator, in a sentence."""
    row, error = finding.row, ERRORS[finding.row.form]
    if finding.verdict == "not identifiable":
        return "the data do not determine it"
    if finding.verdict == "known beforehand":
        return "it follows from known values, independently of the samples"
    if finding.verdict == "bias only":
        return f"error of {off(finding)}, all bias: there is no noise"
    basis = "of one draw" if row.draws == 1 else f"averaged over {row.draws} draws"
    spread = (
        f"the bound is {finding.bound:.3g}; the {error} of an efficient estimator, {basis}, has a median of "
        f"{finding.median:.2g} and a 95 % range of {finding.low:.2g} to {finding.high:.2g}"
    )
    ends = {
        "no number": "",
        "decided by the prior": f", mostly due to the prior; the error of {finding.score:.2g} measures the prior",
        "within": f"; {percentage(finding.larger)} of draws give at least {finding.score:.2g}",
        "smaller": f"; only {percentage(finding.smaller)} of draws give at most {finding.score:.2g}: more was known "
        "than is stated here, or it is chance",
        "larger": f"; only {percentage(finding.larger)} of draws give at least {finding.score:.2g}: the estimate is "
        "not efficient, the data are not as stated here, or it is chance",
    }
    return spread + ends[finding.verdict]


def given(finding: AuditFinding) -> list[str]:
    """Describe the influence of the prior, the initial guess, and the stated standard deviation."""
    lines = []
    if finding.prior_share > 0:
        lines.append(f"{percentage(finding.prior_share)} of the bound's variance is due to the prior")
    if finding.start is not None:
        closer = ", closer than the estimate" if finding.start * finding.bound < finding.score else ""
        lines.append(f"the initial guess was {finding.start:.2g} bounds from the stated value{closer}")
    if finding.sd_ratio is not None:
        lines.append(f"the stated standard deviation is {finding.sd_ratio:.2g} times the bound")
    if FIRST_ORDER * abs(finding.truth) < finding.bound < float("inf"):
        lines.append("the bound, of first order in the noise, is only approximate at this size")
    return lines


def agreement(case: str, check: Consistency) -> str:
    """Describe the agreement of published samples, or of a published solution, with the stated equation."""
    where, s = f"{case}: " if case else "", "" if check.what == "samples" else "s"
    largest = f"{100 * check.difference:.2g} % of the largest value"
    chance = ""
    if check.chance is not None:
        chance = f"; noise of the stated size gives at least this difference in {percentage(check.chance)} of draws"
    if check.agrees:
        return f"{where}the published {check.what} agree{s} with the stated equation: within {largest}{chance}"
    values = ", ".join(f"{name} {fit:.4g} (stated: {stated:g})" for name, (fit, stated) in check.fitted.items())
    return (
        f"{where}the published {check.what} differ{s} from the stated equation by up to {largest}{chance}; the best "
        f"fit, within {100 * check.remaining:.2g} %, has {values}"
    )


def compared(rivals: tuple[AuditFinding, ...]) -> str:
    """Name the methods that are tied, and those with errors beyond the range of an efficient estimator."""
    row = rivals[0].row
    near, far = (
        list(dict.fromkeys(f"'{f.row.method}'" for f in rivals if (f.verdict == "larger") == large))
        for large in (False, True)
    )
    within, outside = " and ".join(near), " and ".join(far)
    where = f"for {', '.join(filter(None, [row.quantity, row.case, row.place]))}"
    if not within:
        larger = f"the errors of {outside} are larger than those of an efficient estimator"
        return f"{where}: {larger}; noise does not explain them"
    draws = "one draw does" if row.draws == 1 else f"{row.draws} draws do"
    tie = f"{draws} not determine which is more accurate, {within}"
    sentence = tie if len(near) > 1 else f"the error of {within} is not larger than those of an efficient estimator"
    return f"{where}: {sentence}{f'; the errors of {outside} are larger' if outside else ''}"


def summary(audit: Audit) -> str:
    """Count the verdicts under the stated reading, and mention inconsistent data."""
    verdicts = [finding.verdict for finding in audit.of("")]
    counts = [f"{verdicts.count(verdict)} {verdict}" for verdict in dict.fromkeys(VERDICTS) if verdict in verdicts]
    differ = not all(check.agrees for _, check in audit.consistency)
    return ", ".join([*counts, *(["data and equation differ"] if differ else [])]) or "nothing reported"


def lines_of(audit: Audit, numbers: bool = True) -> list[str]:
    """Return the sentences of an audit, with or without those on each number."""
    claim, lines = audit.stated.claim, [agreement(case, check) for case, check in audit.consistency]
    for finding in audit.of("") if numbers else ():
        row, others = finding.row, audit.others(finding)
        name = ", ".join(filter(None, [row.method, row.quantity, row.case, row.place]))
        also = [f"under other readings: {others}"] if others else []
        lines.append("; ".join([f"{name}, {reported(finding)}: {placed(finding)}", *given(finding), *also]))
    lines += ["; ".join(why) for why in dict.fromkeys(finding.why for finding in audit.of("") if finding.why)]
    lines += map(compared, audit.rivals)
    return lines + [f"assumed: {text}" for text in claim.assumed] + [f"missing: {text}" for text in claim.missing]


def paragraph(audit: Audit) -> str:
    """Return the audit as a paragraph for citation."""
    source = audit.stated.claim.source
    place = f", {source.place}" if source.place else ""
    begin = f"{source.authors} ({source.year}), {source.title}{place}, {source.url}."
    return " ".join([begin, *(f"{line[0].upper()}{line[1:].rstrip('.')}." for line in lines_of(audit))])


def badge(audit: Audit) -> str:
    """Return the summary as a badge (SVG)."""
    text = summary(audit)
    length, colour = 6 * len(text), "#a60" if "differ" in text else "#357"
    return BADGE.format(width=length + 58, right=length + 14, length=length, text=text, colour=colour)


def as_dict(audit: Audit) -> dict[str, Any]:
    """Return the audit as plain values for JSON."""
    claim = audit.stated.claim
    return {
        "claim": audit.stated.name, "source": claim.source.model_dump(), "summary": summary(audit),
        "findings": [{**asdict(finding), "row": finding.row.model_dump()} for finding in audit.findings],
        "comparisons": [compared(rivals) for rivals in audit.rivals],
        "consistency": [{"case": case, "agrees": check.agrees, **asdict(check)} for case, check in audit.consistency],
        "assumed": claim.assumed, "missing": claim.missing, "paragraph": paragraph(audit),
    }  # fmt: skip
