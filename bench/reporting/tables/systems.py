"""Tables of experiments over several systems: one panel a system, methods down, noise levels across.

They stand for every experiment whose ``table`` has the form ``systems`` (Tables 6 to 9). Systems have parameters of
their own, so what a panel compares is pooled over them: of each replicate the root mean square over the parameters of
error over bound, on those quantities that the data tell.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial

import numpy as np

from bench.dynamics.modal import modes
from bench.reporting.frame import ERROR, Frame, Line, Result, group, line
from bench.reporting.labels import in_order, states_terms, title, told
from bench.reporting.rounding import answered, excess_text, number, percent, readable, with_excess
from bench.reporting.tables.pooling import (
    MODAL,
    lower_median,
    modal_scores,
    pooled_bound,
    pooled_coverage,
    pooled_errors,
    pooled_excess,
    pooled_quantities,
)
from bench.reporting.tables.render import MISSING, Columns, Rows, bold, failure_notes, files, listing, panel, ranked
from bench.reporting.terms import terms_found
from bench.scenario.scenario import Scenario
from bench.scoring.comparison import ScenarioRanking, standing

COLUMNS = (
    "table", "system", "initial_state", "snr_db", "method", "metric", "mean", "median", "ci_low", "ci_high", "bound",
    "prior_share", "excess", "coverage_95", "n_ok", "n",
)  # fmt: skip
MANY = 8
"""Parameters beyond which a panel of single parameters would not be read."""
SHOWN_AT = 20.0
"""The noise level (dB) at which single parameters are shown; the middle one where an experiment has not this."""
UNTOLD = 1.0
"""A relative standard deviation at the bound beyond which a quantity is practically not identifiable."""
LEGEND = """Each panel is one system. Of each noise level: **error**, the pooled excess of the quantities that the
data tell (root mean square over replicates and quantities of error over Cramér-Rao bound: 1 is the best that an
unbiased method can do); **RMSE**, the median displacement error (m) and after × its excess; **95 %**, the share of
the 95 % intervals of all parameters that held the truth. With a known force, or a known added mass, the data tell
every parameter, there is no prior, and the errors of m, c and k are true errors; in free vibration the data tell
ratios, and the prior (a weighed mass) tells the scale. The row *bound* gives the bound: pooled in percent, and of
the RMSE. *oracle* is maximum a posteriori (without a prior: maximum likelihood) started at the truth. Excesses are
over the successful replicates, *ok* of n; a failed one counts as an infinite error in medians and ranks. Bold: the
method of least median error, and all that cannot be told from it on the same data (Wilcoxon's signed-rank test,
Holm's adjustment, 5 %) or are less than 2 % from it, unless gross errors double its excess. A dash for a share:
the method states no interval. ×>1e6: some estimates ran away, and how far says nothing. Time: processor time of the
median fit. A dash for an error: the experiment does not ask for it. What a method cannot take is said below
its panel."""


def heading(result: Result) -> str:
    """The scenario's name, with what disturbs it."""
    return result.system + (f", {result.disturbance}" if result.disturbance else "")


def panels(results: Sequence[Result]) -> list[list[Result]]:
    """The results of each system, disturbance and reading of the start."""
    return list(group(results, lambda result: (heading(result), result.initial_state, result.kind)).values())


def told_quantities(result: Result) -> tuple[str, ...]:
    """The quantities that the data tell."""
    return pooled_quantities(result.model, result.identifiable)


def any_stored(results: Sequence[Result]) -> dict[float, Result]:
    """By noise level some stored result, for what all share: bounds and identifiability."""
    return {result.snr_db: result for result in reversed(results) if result.stored}


# ---- the tidy table


def lines(table: str, results: Sequence[Result]) -> list[Line]:
    """One line a cell and metric: every score, the pooled ones, those of the modes, and the bound."""
    return [{"table": table, **one} for own in panels(results) for result in own for one in _lines(result)]


def _lines(result: Result) -> Iterator[Line]:
    of_cell = ("initial_state", "snr_db", "method", "n_ok", "n")
    head = {**line(result, "", of_cell), "system": heading(result)}
    if result.stored is None:
        yield {**head, "metric": "not run"}
        return
    model = result.scenario.make_system()
    pools = {
        "told_pooled": told_quantities(result), "parameters_pooled": model.names,
        "groups_pooled": tuple(group.name for group in model.groups),
    }  # fmt: skip
    for name, names in pools.items():
        covered = pooled_coverage(result, names)[0]
        yield {**head, "metric": name, "excess": pooled_excess(result, names), "coverage_95": covered}
    for metric in result.summary:
        if metric.endswith(ERROR) or metric.startswith("rmse"):
            yield {**line(result, metric, COLUMNS), "system": heading(result)}
    for metric, values in modal_scores(result).items():
        yield {**head, "metric": metric, "median": lower_median(values)}


# ---- the table of a panel


def standings(results: Sequence[Result]) -> dict[tuple[float, int], ScenarioRanking | None]:
    """By noise level, where methods stand by the pooled errors (0) and the displacement's (1).

    Reference rows, and methods without any successful replicate, are left out.
    """
    found = {}
    rivals = [result for result in results if result.n_ok and not result.is_reference]
    for level, own in group(rivals, lambda result: result.snr_db).items():
        pooled = {result.label: pooled_errors(result, told_quantities(result)) for result in own}
        excess = {result.label: pooled_excess(result, told_quantities(result)) for result in own}
        found[level, 0] = standing(pooled, excess, 1.0)  # pooled errors are over their bounds
        found[level, 1] = ranked(own, "rmse")
    return found


def table(results: Sequence[Result]) -> Rows:
    """A method a row, noise levels side by side; the bound first."""
    ranking, levels = standings(results), list(group(results, lambda result: result.snr_db))
    rows, headers = panel(
        results,
        lambda result: result.label,
        {"method": lambda own: own[0].title},
        lambda result: result.snr_db,
        partial(_level, ranking),
        {"time (s)": _time, "uses": _uses, "ok": partial(_counts, levels)},
        rest="",
        order=in_order,
    )
    known, bound = any_stored(results), ["bound"]
    for level in levels:
        one = known.get(level)
        texts = (f"{number(pooled_bound(one, told_quantities(one)))} %", number(one.bound("rmse"))) if one else "--"
        bound += [*texts, ""]
    return [[*bound, "", "", ""], *rows], headers


def _level(ranking: Mapping[tuple[float, int], ScenarioRanking | None], any_result: Result) -> Columns[Result]:
    level = any_result.snr_db

    def leads(result: Result, i: int) -> bool:
        found = ranking.get((level, i))
        return found is not None and result.label in found.level

    def error(result: Result) -> str:
        if not result.n_ok:
            return result.status.value if result.stored else "not run"
        pooled = pooled_excess(result, told_quantities(result))
        return bold(f"×{excess_text(pooled)}" if math.isfinite(pooled) else MISSING, leads(result, 0))

    def rmse(result: Result) -> str:
        return bold(_median(result, "rmse"), leads(result, 1)) if result.n_ok else ""

    def covered(result: Result) -> str:
        names = result.scenario.make_system().names
        return percent(pooled_coverage(result, names)[0]) if result.n_ok else ""

    return {f"{level:g} dB error": error, f"{level:g} dB RMSE (m)": rmse, f"{level:g} dB 95 %": covered}


def _median(result: Result, metric: str) -> str:
    """The median of a metric and its excess, where the result has it."""
    if metric not in result.summary:
        return MISSING
    return with_excess(result.statistic(metric, "median"), result.excess(metric))


def _time(own: Sequence[Result]) -> str:
    times = [lower_median(result.cpu_s[result.ok]) for result in own if result.n_ok]
    return f"{np.median(times):.2g}" if times and not own[0].is_reference else ""


def _uses(own: Sequence[Result]) -> str:
    """What a method was told beyond the data, of what there was to tell here."""
    if not any(result.n_ok for result in own):
        return ""
    scenario = own[0].scenario
    there = {"start": scenario.initial_state == "known", "prior": scenario.prior is not None}
    return ", ".join(word for word in told(own[0].method).split(", ") if there.get(word.partition(" ")[0], True))


def _counts(levels: Sequence[float], own: Sequence[Result]) -> str:
    """Fits that gave an answer, of all: once where it is the same at every noise level."""
    known = {result.snr_db: answered(result.n_ok, result.n) for result in own if result.stored}
    counts = [known.get(level, MISSING) for level in levels]
    return counts[0] if len(set(counts)) == 1 else ", ".join(counts)


# ---- what stands below it


def notes(results: Sequence[Result]) -> list[str | Rows]:
    """Single parameters, modes, terms, what cannot be told, and failures; what there is of them."""
    good = [result for result in results if result.n_ok]
    return [*_parameters(results), *_modes(results), *_terms(good), _untold(results), failure_notes(results)]


def _parameters(results: Sequence[Result]) -> list[str | Rows]:
    """The single parameters and groups at one noise level: median error in percent and excess."""
    levels = list(group(results, lambda result: result.snr_db))
    level = SHOWN_AT if SHOWN_AT in levels else levels[len(levels) // 2]
    stored, own = any_stored(results).get(level), results[0].scenario.make_system().names
    if stored is None or len(own) > MANY:
        return []
    names = list(dict.fromkeys([*own, *told_quantities(stored)]))
    columns = {readable(name): partial(_median, metric=name + ERROR) for name in names}
    shown = {result.label: result for result in results if result.n_ok and result.snr_db == level}
    rows, headers = listing(
        (shown[label] for label in in_order(shown)), {"method": lambda result: result.title, **columns}
    )
    bound = ["bound", *(number(stored.bound(name + ERROR)) for name in names)]
    return [f"Errors at {level:g} dB, in percent (median ×excess):", ([bound, *rows], headers)]


def _modes(results: Sequence[Result]) -> list[str | Rows]:
    """Natural frequencies, damping ratios and mode shapes: medians over the replicates, at every noise level."""
    labels = {result.label for result in results if result.n_ok and modal_scores(result)}
    if not labels:
        return []
    what = (
        "As modes (median over the replicates of the root mean square error over the modes, and of the lowest "
        "modal assurance criterion):"
    )
    first: Columns[Sequence[Result]] = {"method": lambda own: own[0].title}
    shown = [result for result in results if result.label in labels]
    return [what, panel(shown, lambda one: one.label, first, lambda one: one.snr_db, _modal, order=in_order)]


def _modal(any_result: Result) -> Columns[Result]:
    def median(metric: str) -> Callable[[Result], str]:
        return lambda result: number(lower_median(modal_scores(result)[metric])) if result.n_ok else MISSING

    names = ("frequencies %", "damping ratios %", "MAC")
    return {f"{any_result.snr_db:g} dB {name}": median(metric) for name, metric in zip(names, MODAL, strict=True)}


def _terms(good: Sequence[Result]) -> Iterator[str]:
    """What sparse models are made of: how often a method found exactly the terms of the equation of motion."""
    by_label = group((one for one in good if states_terms(one.label)), lambda result: result.label)
    for label in in_order(by_label):
        found = [f"{one.snr_db:g} dB: {terms_found(one.stored, one.scenario)}" for one in by_label[label] if one.stored]
        yield f"{title(label)} by the terms it finds. {'; '.join(found)}."


def _untold(results: Sequence[Result]) -> str:
    """What cannot be identified, at each noise level where it is so."""
    sentences, known = [], any_stored(results)
    scenario, first = results[0].scenario, results[0].snr_db
    names = [quantity.name for quantity in scenario.make_system().quantities]
    for level in group(results, lambda result: result.snr_db):
        if level not in known:
            continue
        never = [name for name in names if not known[level].identifiable.get(name, True)]
        bounds = {name: known[level].bound(name + ERROR) for name in names if name not in never}
        weak = [f"{n} (bound {number(b)} %)" for n, b in bounds.items() if 100 * UNTOLD < b < math.inf]
        if level == first and never:
            said = ", ".join(f"{readable(name)} ({_prior_shares(name, known.values())} %)" for name in never)
            sentences.append(
                f"Not told by the data alone (the prior's share of the variance at the bound, over the noise): {said}."
                if scenario.prior
                else f"Not identifiable at any noise: {', '.join(map(readable, never))}."
            )
        if weak:
            sentences.append(f"At {level:g} dB practically not identifiable: {', '.join(map(readable, weak))}.")
    return " ".join(sentences)


def _prior_shares(name: str, results: Iterable[Result]) -> str:
    """The least and the largest share, in percent."""
    shares = [result.prior_share.get(name, math.nan) for result in results]
    least, most = percent(min(shares)), percent(max(shares))
    return least if least == most else f"{least} to {most}"


def describe(scenario: Scenario) -> str:
    """What is measured, for how long and how finely, and what is told, in a sentence."""
    system = scenario.make_system()
    n, sensors = system.n_dof, scenario.measured_dofs
    places = (
        ""
        if n == 1
        else " of every mass"
        if len(sensors) == n
        else f" of mass {', '.join(str(i + 1) for i in sensors)}"
    )
    words = [f"{len(system.names)} parameters", f"{scenario.samples} samples over {scenario.duration:g} s{places}"]
    if system.linear:
        frequencies = modes(system, scenario.parameters).frequencies
        step = scenario.duration / (scenario.samples - 1)
        cycles, finest = scenario.duration * frequencies[0], 1.0 / (frequencies[-1] * step)
        words.append(f"{cycles:.3g} periods of the slowest mode, {finest:.3g} samples in one of the fastest")
    if scenario.force:
        noisy = "" if scenario.force.noise_db is None else f" (measured with noise, {scenario.force.noise_db:g} dB)"
        words.append(
            f"known force: {scenario.force.kind}, {scenario.force.hold.replace('_', '-')} between its samples{noisy}"
        )
    if scenario.added_mass:
        words.append(f"a second record with {', '.join(f'{m:g}' for m in scenario.added_mass)} kg added")
    prior = "no prior" if scenario.prior is None else f"{scenario.prior.name} prior"
    return f"{'; '.join(words)}. Initial state {scenario.initial_state}, {prior}."


def system_table(frame: Frame) -> Mapping[str, str]:
    """The files of the table by name; none where the store holds no cell of it."""
    if not frame.any_stored:
        return {}
    parts: list[str | Rows] = [f"# {frame.heading}", LEGEND]
    captioned = []
    for own in panels(frame.results):
        said, shown = describe(own[0].scenario), table(own)
        parts += [f"## {heading(own[0])}", said, shown, *notes(own)]
        captioned.append((f"{frame.title}: {heading(own[0])}. {said}", shown))
    parts.append(
        f"Every single quantity and all 95 % intervals of medians are in the CSV. Regenerate: `{frame.command}`"
    )
    data = lines(str(frame.number or frame.experiment), frame.results)
    return files(frame.name, parts, data, COLUMNS, latex=captioned)
