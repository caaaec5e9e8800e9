"""Claims on the whole: what is compared, what it costs, and what broken assumptions do."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from bench.entrants.registry import registered
from bench.reporting.claims.claim import Said, claim, fold, number, percent, said, span, within
from bench.reporting.claims.evidence import PRIMARY, Evidence
from bench.reporting.claims.free_decay import ON_THE_BOUND
from bench.reporting.labels import title

TABLES = tuple(f"table{number}" for number in range(2, 10))
PINN_TABLE = "pinn_family"
PAPER_TABLES = ("table2", "table3", "table4", "table5")


def _share_data(e: Evidence, methods: Collection[str]) -> int:
    """The most of these methods that have an answer in one panel."""
    keys = ["system", "initial_state", "snr_db"]
    lines = (e.table(name) for name in TABLES)
    answered = (one[(one.n_ok > 0) & one.method.isin(methods)] for one in lines)
    return max(int(one.groupby(keys).method.nunique().max()) for one in answered)


@claim
def compared(e: Evidence) -> Said:
    """Which method should an engineer use to identify the mass, damping and stiffness of a vibrating system from
    few, noisy displacement samples, and how much of the answer can be believed? This benchmark runs {methods}
    identification methods, each on data that it can take, up to {shared} on the same, scores them against the truth
    that only the harness knows, and sets each result beside the Cramér-Rao bound: the best that the data allow. It
    starts from the tables of a published study (Karkadakattil 2026,
    [doi:10.25082/RIMA.2026.02.002](https://doi.org/10.25082/RIMA.2026.02.002)) and shows that paper's numbers
    beside its own.
    """
    methods = set(registered())
    shown = {name for table in (*TABLES, PINN_TABLE) for name in e.table(table).method}
    shared = _share_data(e, methods)
    conditions = {"every method stands in a table": methods <= shown, "several share a data set": shared > 2}
    return said(conditions, methods=str(len(methods)), shared=str(shared))


@claim
def archive(e: Evidence) -> Said:
    """The published results, {cells} cells, come with the clone as [results/archive](results/archive), {size} MB of
    Parquet.
    """
    cells = e.archived
    return said({"there is an archive": cells > 0}, cells=f"{cells:,}", size=number(e.archive_size / 1e6, 3))


@claim
def broken_assumptions(e: Evidence) -> Said:
    """What it says: jitter of 2 % of a step, a bias and a drift of 5 and 10 % of the signal change the errors of
    the methods on the bound by factors of {small}; outliers cost them factors of {outliers}, the oracle too
    ({oracle}), for all of them take the noise for normal. A start told 20 ms too early multiplies the error of k/m
    by {late} for these methods, and by {pencil} for the matrix pencil, which does not use it. At random sample
    times the error of k/m grows by factors of {astray} for finite differences and the smoothing spline, and by
    {shooting} for multiple shooting. Student's t errors (`shooting_student`) bring the outliers' factor down to
    {student}, and cost {clean} times the error where there are none.
    """

    def ratios(kinds: str | Sequence[str], methods: str | Sequence[str], metrics: str | Sequence[str]) -> list[float]:
        return list(e.rows("robustness", disturbance=kinds, method=methods, metric=metrics)["ratio"].dropna())

    small = ratios(("jitter", "bias", "drift"), ON_THE_BOUND, PRIMARY)
    outliers = ratios("outliers", ON_THE_BOUND, PRIMARY)
    (pencil,) = ratios("late_trigger", "matrix_pencil", PRIMARY[0])
    late = ratios("late_trigger", ON_THE_BOUND, PRIMARY[0])
    astray = ratios("irregular", ("ls", "ls_spline"), PRIMARY[0])
    student = ratios("outliers", "shooting_student", PRIMARY)

    def undisturbed(method: str, metric: str) -> float:
        asked = {"disturbance": "none", "initial_state": "unknown", "method": method, "metric": metric}
        return e.value("robustness", "excess", **asked)

    clean = [undisturbed("shooting_student", one) / undisturbed("shooting", one) for one in PRIMARY]
    (shooting,) = ratios("irregular", "shooting", PRIMARY[0])
    return said(
        {
            "jitter, bias and drift matter less than 15 %": within(small, 0.85, 1.15),
            "outliers cost at least a factor of 1.8": min(outliers) > 1.8,
            "a late trigger costs at least a factor of 1.5": min(late) > 1.5,
            "and the matrix pencil nothing": within([pencil], 0.95, 1.05),
            "random sample times cost the two at least a factor of 2, shooting less": min(astray) > 2 > shooting,
            "Student's t errors halve what outliers cost": max(student) < 0.6 * min(outliers),
            "and cost less than 15 % without them": max(clean) < 1.15,
        },
        small=span(small),
        outliers=span(outliers),
        oracle=span(ratios("outliers", "oracle", PRIMARY)),
        late=span(late),
        pencil=fold(pencil),
        astray=span(astray),
        shooting=fold(shooting),
        student=span(student),
        clean=span(clean),
    )


@claim
def cost(e: Evidence) -> Said:
    """- Processor time of the fits of Tables 2 to 5 at these replicates, one core: {minutes} minutes, of them
    {most}.
    """
    cells = {one.identity: one for table in PAPER_TABLES for one in e.stored(table)}.values()
    minutes: dict[str, float] = {}
    for one in cells:
        minutes[one.label] = minutes.get(one.label, 0.0) + float(one.cpu_s[one.cpu_s > 0].sum()) / 60
    total = sum(minutes.values())
    shares = sorted(((spent / total, label) for label, spent in minutes.items()), reverse=True)[:4]
    return said(
        {"these four are most of it": sum(share for share, _ in shares) > 0.5},
        minutes=number(total),
        most=", ".join(f"{percent(share)} % for {title(label)}" for share, label in shares),
    )


OVERVIEW, ARCHIVE, BROKEN, COST = (compared,), (archive,), (broken_assumptions,), (cost,)
CLAIMS = (*OVERVIEW, *ARCHIVE, *BROKEN, *COST)
