"""What the short paper says: the sentences of other passages, with the same numbers, as running text."""

from __future__ import annotations

from bench.reporting.claims import atlas, free_decay, off_table, wider
from bench.reporting.claims.claim import Claim, Said, claim, said
from bench.reporting.claims.evidence import Evidence


def _of(source: Claim, e: Evidence) -> tuple[dict[str, bool], dict[str, str]]:
    """The conditions and the numbers of another claim, which are then this one's as well."""
    found = source.said(e)
    return dict(found.conditions), dict(found.numbers)


@claim
def paper_size(e: Evidence) -> Said:
    """The harness has {methods} identification methods, each scored on the data that it can take; the published results
    hold {cells} cells, and an atlas of free decays {fits} fits at {points} points.
    """
    known, counted = _of(wider.compared, e)
    there, stored = _of(wider.archive, e)
    points, size = _of(atlas.atlas_size, e)
    conditions = {**known, **there, **points}
    return said(conditions, methods=counted["methods"], cells=stored["cells"], fits=size["fits"], points=size["points"])


@claim
def paper_results(e: Evidence) -> Said:
    """For the free decay of the study that it started from, multiple shooting, Markov-chain Monte Carlo, a
    physics-informed network and spline collocation are all on the Cramér-Rao bound (excess {excess} from 40 to 10 dB).
    The network is not the reason: a spline in its place is as accurate in {share} % of the time. Least squares on
    finite differences is {error} % off in k/m at 40 dB, where the bound is {bound} %. On the {n} randomly drawn
    scenarios that tell k/m, multiple shooting is grossly wrong, or silent, in {shooting} %, and spline collocation in
    {spline} %.
    """
    on_it, bound = _of(free_decay.on_the_bound, e)
    spline, network = _of(free_decay.network, e)
    biased, differences = _of(free_decay.differences, e)
    alike, drawn = _of(off_table.open_split, e)
    return said(
        {**on_it, **spline, **biased, **alike},
        excess=bound["excess"],
        share=network["share"],
        error=differences["error"],
        bound=differences["bound"],
        n=drawn["n"],
        shooting=drawn["shooting"],
        spline=drawn["spline"],
    )


CLAIMS = (paper_size, paper_results)
