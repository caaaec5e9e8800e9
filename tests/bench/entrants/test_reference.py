"""The oracle answers where the noise hides a damping altogether."""

from __future__ import annotations

import numpy as np

from bench.config.experiment import expand
from bench.contract.estimate import Status
from bench.entrants.reference import oracle_estimate


def test_a_parameter_that_runs_to_zero_leaves_an_answer_without_an_interval() -> None:
    """At 10 dB a damping of the forced chain has its maximum of likelihood at nothing in some replicates."""
    arguments = ["method=oracle", "system=chain2_forced", "snr=10", "initial_state=known", "replicates=3"]
    (cell,) = [job.cell() for job in expand(arguments, multirun=False)]
    problem, truth = cell.scenario.replicates(cell.seed, 3)[2]
    with np.errstate(all="ignore"):  # as the scoring process calls it: the search may try where exp overflows
        estimate = oracle_estimate(problem, truth)
    assert estimate.status is Status.OK
    found = estimate.parameters.values()
    assert min(found[name] / truth.parameters[name] for name in ("c1", "c2")) < 1e-3
    assert all(0.5 < found[name] / truth.parameters[name] < 2.0 for name in ("m1", "m2", "k1", "k2"))
