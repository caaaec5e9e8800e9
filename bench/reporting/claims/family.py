"""Claims on the PINN family: what decides the time, what decides the answer, whose intervals hold."""

from __future__ import annotations

import numpy as np
import pandas as pd

from bench.reporting.claims.claim import Said, claim, fold, number, percent, said, span
from bench.reporting.claims.evidence import Evidence
from bench.reporting.tables.family_numbers import PLACE
from bench.reporting.tables.family_sentences import HALF

TABLE = "pinn_family"
OURS, PAPERS = "our base", "the paper's base"
STATING = "Ways of stating uncertainty"


def _lines(e: Evidence, section: str, quantity: str, **wanted: str) -> pd.Series:
    """A quantity by row, where trainings are compared."""
    snr, start = PLACE
    found = e.rows(TABLE, section=section, quantity=quantity, snr_db=snr, initial_state=start, **wanted)
    return found.set_index("row")["value"].astype(float)


def _arrivals(e: Evidence, base: str) -> pd.Series:
    """Seconds to within 1 % of the minimum, by optimiser; infinite where half of the fits or more never came."""
    seconds, share = (_lines(e, "Optimisers", name, base=base) for name in ("arrival_s", "arrived_share"))
    return seconds.where(share.reindex(seconds.index) > HALF, np.inf)


@claim
def family_optimisers(e: Evidence) -> Said:
    """- **The optimiser decides how long it takes.** On the paper's loss {papers} of {count} come within 1 % of the
    minimum, in {least} to {most} s of one core; the paper's own, Adam and then L-BFGS, in {own} s. On ours {ours} do;
    Levenberg-Marquardt takes {lm} s, Adam and then L-BFGS {adam} s.
    """
    papers, ours = _arrivals(e, PAPERS), _arrivals(e, OURS)
    there, here = papers[np.isfinite(papers)], ours[np.isfinite(ours)]
    lm, adam = "Levenberg-Marquardt", "Adam, then L-BFGS"
    return said(
        {
            "Levenberg-Marquardt is the first on both": there.idxmin() == here.idxmin() == lm,
            "most arrive": min(there.size, here.size) > HALF * papers.size,
            "by a factor of a hundred": adam in here and here[adam] > 100 * here[lm],
        },
        papers=str(there.size),
        count=str(papers.size),
        least=number(there.min(), 1),
        most=number(there.max()),
        own=number(there[adam]),
        ours=str(here.size),
        lm=number(here[lm], 1),
        adam=number(here[adam]),
    )


@claim
def family_weightings(e: Evidence) -> Said:
    """- **The weighting decides what is found.** The minimum of the paper's loss has errors of k/m and c/m {k} and {c}
    times the bound, that of ours {own_k} and {own_c} times, on the same data. Of {count} weightings none ends nearer
    to the bound by more than a hundredth.
    """
    k, c = (_lines(e, "Weightings", f"{group}_excess_at_minimum", base=OURS) for group in ("k_over_m", "c_over_m"))
    papers, own = "fixed, all one", "by the estimated noise"
    both = np.hypot(k, c) / np.sqrt(2.0)
    return said(
        {
            "the paper's minimum is farther from the truth": bool(k[papers] > k[own] and c[papers] > 1.2 * c[own]),
            "no weighting is nearer": bool((both > both[own] - 0.01).all()),
        },
        k=fold(k[papers]),
        c=fold(c[papers]),
        own_k=fold(k[own]),
        own_c=fold(c[own]),
        count=str(k.size),
    )


@claim
def family_rivals(e: Evidence) -> Said:
    """- **DeepXDE, jinns and PINA**, as they ship, find the same minimum of the paper's loss: errors of k/m {k} and of
    c/m {c} times the bound on {n} data sets, where our training of that loss has {own_k} and {own_c}. A fit takes them
    {seconds} s.
    """
    errors = ("k_over_m_excess", "c_over_m_excess")
    k, c, seconds = (_lines(e, "Other packages", name) for name in (*errors, "fit_s"))
    own_k, own_c = (_lines(e, "Optimisers", name, base=PAPERS)["Adam, then L-BFGS"] for name in errors)
    (n,) = e.rows(TABLE, section="Other packages", quantity="fit_s").n.unique()
    return said(
        {
            "three packages": k.size == 3,
            "they agree": k.max() < 1.1 * k.min() and c.max() < 1.1 * c.min(),
            "our row is near theirs": abs(own_c / c.mean() - 1.0) < 0.1,
        },
        k=span(k),
        c=span(c),
        n=f"{n:.0f}",
        own_k=fold(own_k),
        own_c=fold(own_c),
        seconds=span(seconds, number),
    )


@claim
def family_uncertainty(e: Evidence) -> Said:
    """- **95 % intervals of k/m held the truth** in {laplace} % of {n} data sets by the linearisation and {mcmc} % by
    MCMC; by a Bayesian PINN (NUTS over all weights, {nuts_s} s a fit) in {nuts} %, with errors {nuts_k} times the
    bound; by mean-field variation in {variational} %, by an ensemble over initialisations in {ensemble} %, by
    Monte-Carlo dropout in {dropout} %.
    """
    held = _lines(e, STATING, "k_over_m_coverage_95", base=OURS)
    mcmc = _lines(e, "Reference rows", "k_over_m_coverage_95")["Bayesian MCMC"]
    lines = e.rows(TABLE, section=STATING, base=OURS, snr_db=PLACE[0], initial_state=PLACE[1])
    nuts, ensemble, dropout = "Bayesian PINN, NUTS", "deep ensemble", "Monte-Carlo dropout"
    error, seconds = (_lines(e, STATING, name, base=OURS)[nuts] for name in ("k_over_m_excess", "fit_s"))
    return said(
        {
            "the linearisation holds its level": 0.89 <= held["Laplace, all weights"] <= 1.0,
            "the ensemble does not": held[ensemble] < 0.5,
            "nor does dropout": held[dropout] < 0.5,
            "nor mean-field variation": held["variational, mean field"] < 0.8,
            "NUTS is off the bound": error > 1.5,
            "as many data sets for both": {100} == set(lines[lines.row.isin([nuts, "Laplace, all weights"])].n),
        },
        laplace=percent(held["Laplace, all weights"]),
        n=f"{lines[lines.row == nuts].n.max():.0f}",
        mcmc=percent(mcmc),
        nuts=percent(held[nuts]),
        nuts_s=number(seconds),
        nuts_k=fold(error),
        variational=percent(held["variational, mean field"]),
        ensemble=percent(held[ensemble]),
        dropout=percent(held[dropout]),
    )


CLAIMS = (family_optimisers, family_weightings, family_rivals, family_uncertainty)
