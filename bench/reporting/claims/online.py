"""What README says of the online track, from Table 10."""

from __future__ import annotations

from bench.config.online import online_scenario
from bench.reporting.claims.claim import Claim, Said, claim, fold, said
from bench.reporting.claims.evidence import Evidence
from bench.reporting.tables.online_table import BOUND

KNOWN, UNKNOWN = "step10_multisine", "step10_ambient"
TITLES = {
    "ekf": "the EKF", "ukf": "the UKF", "square_root": "the square-root EKF", "imm": "the IMM",
    "change_points": "Bayesian change-point detection", "cusum": "the EKF with CUSUM", "glr": "the likelihood ratio",
    "ar": "the recursive AR model", "ssi": "SSI",
}  # fmt: skip


def _nearest(e: Evidence, scenario: str) -> dict[str, str]:
    """The method nearest to the bound by the farther of k/m and c/m, its excesses and its delay, and the bound's."""
    table = e.rows("table10", scenario=scenario)
    table = table[table.ok == table.ok.max()]
    wide = table.pivot(index="method", columns="quantity", values="excess").drop(index=BOUND).dropna()
    best = str(wide.max(axis=1).idxmin())
    delays = table[table.quantity == "k_over_m"].set_index("method").delay
    excess = wide.loc[best]
    return {
        "method": TITLES.get(best, best),
        "k": fold(float(excess["k_over_m"])),
        "c": fold(float(excess["c_over_m"])),
        "delay": f"{delays[best]:.0f}",
        "bound": f"{delays[BOUND]:.0f}",
    }


@claim
def online_steps(e: Evidence) -> Said:
    """- **A stiffness that falls by {change}**, at 20 dB. Under a known multisine {known_method} is nearest to the
    bound (k/m {known_k} times, c/m {known_c}); its interval excludes the old value after {known_delay} samples, where
    the bound would allow it after {known_bound}. Under an unknown white force {unknown_method} is (k/m {unknown_k},
    c/m {unknown_c}), after {unknown_delay} samples beside {unknown_bound}. The bound is told when the stiffness
    changes, and that it is the stiffness; a tracker has to find that out, and errs by the whole change meanwhile.
    """
    found = {"known": _nearest(e, KNOWN), "unknown": _nearest(e, UNKNOWN)}
    change = online_scenario(KNOWN).varying["k"].change
    return said(
        {
            "no tracker is below the bound": min(float(own["k"]) for own in found.values()) >= 1.0,
            "an unknown force takes longer": float(found["unknown"]["delay"]) > float(found["known"]["delay"]),
        },
        change=f"{abs(change):.0%}".replace("%", " %"),
        **{f"{kind}_{name}": text for kind, own in found.items() for name, text in own.items()},
    )


CLAIMS: tuple[Claim, ...] = (online_steps,)
