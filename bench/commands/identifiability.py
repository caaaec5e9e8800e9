"""The verb ``identifiability``: which quantities the data of a scenario determine."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from bench.commands.declaration import Others, Parsed

SCENARIO = ("system", "snr", "initial_state", "prior", "seed")


def dofs(text: str) -> tuple[int, ...]:
    """Read one DOF or a list of DOFs, counted from 0."""
    try:
        return tuple(int(part) for part in text.strip("[]").split(","))
    except ValueError:
        raise ValueError("a list of DOFs counted from 0, such as [0,1]") from None


def identifiability(
    scenario: Annotated[
        Sequence[str], Others(SCENARIO), "system=, system.<field>=, snr=, initial_state=, prior=, seed="
    ],
    measured: Annotated[tuple[int, ...] | None, Parsed(dofs), "DOFs with a sensor [all], as [0,1]"] = None,
    profile: Annotated[bool, "profile likelihoods of one replicate, printed and drawn"] = False,
    out: Annotated[Path, "folder of the picture"] = Path("results/figures"),
) -> int:
    """State which quantities the data of a scenario determine.

    Structure: what is identifiable from perfect data. Practice: the Cramér-Rao bound for these samples at this noise,
    and the share of the variance due to the prior. The true values are used: this judges a scenario, not a record.
    """
    from bench.config.experiment import expand
    from bench.information.fisher import information
    from bench.information.structural import check_dofs, structure_of
    from bench.reporting.identifiability import identifiability_page, profile_intervals
    from bench.reporting.whole_file import check_folder

    job = expand([*scenario, "method=oracle"], multirun=False)[0]
    simulated = job.cell().scenario
    channels = measured or simulated.measured_dofs
    check_dofs(simulated.make_system(), channels)
    if profile:
        from bench.reporting.pictures import style as _  # noqa: F401 - a missing package is reported before the work

        check_folder(out)
    structure = structure_of(simulated, channels)
    fisher = information(simulated, job.config.seed, channels)
    print(identifiability_page(simulated, channels, structure, fisher))
    if profile:
        table, paths = profile_intervals(simulated, channels, structure, fisher, job.config.seed, out)
        print(f"\n{table}", *paths, sep="\n")
    return 0
