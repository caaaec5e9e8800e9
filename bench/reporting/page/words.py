"""Format numbers, names and addresses for the site."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Mapping, Sequence

from scipy.stats import beta

from bench.config.experiment import Experiment
from bench.reporting.frame import ERROR, Result
from bench.reporting.ranking import Ranked
from bench.reporting.rounding import number, readable

USUAL_DB = 20.0
"""SNR (dB) that is shown first, or the nearest available one."""
LONGEST = 80
"""Largest number of characters of an address."""
SIZES = {
    "integrator": "relative tolerance {:g}", "jitter": "{:g} of a step", "irregular": "",
    "coloured": "correlation {:g}", "heavy_tails": "{:g} degrees of freedom", "outliers": "{:g} × the noise",
    "bias": "{:g} of the signal’s rms", "drift": "{:g} of the signal’s rms at the end", "late_trigger": "{:g} s",
}  # fmt: skip
"""Formats of the size of a disturbance, by kind; other kinds show the number alone."""


def quantity(metric: str) -> str:
    """Return the quantity of an error metric: ``k/m`` for ``k_over_m_error_pct``, ``displacement`` for ``rmse``."""
    return "displacement" if metric == "rmse" else readable(metric.removesuffix(ERROR))


def heading(metric: str) -> str:
    """Return the quantity of an error metric, with the unit of the error."""
    return f"{quantity(metric)} ({'m' if metric == 'rmse' else '%'})"


def percent(share: float) -> str:
    """Format a share in percent with two digits."""
    return "–" if math.isnan(share) else "100\u00a0%" if share >= 0.995 else f"{100 * share:.2g}\u00a0%"


def decibels(snr_db: float) -> str:
    """Format a signal-to-noise ratio to a tenth of a decibel."""
    return f"{round(snr_db, 1):g}"


def disturbed(kind: str, size: float) -> str:
    """Describe a disturbance and its size; empty for none."""
    text = "" if math.isnan(size) else SIZES.get(kind, "{:g}").format(size)
    return (f"{kind}, {text}" if text else kind).replace("_", " ")


def system_words(facts: Result) -> str:
    """Describe a system: number of masses, nonlinearity, and force."""
    model = facts.known_model
    n = model.n_dof if model else facts.n_dof or 1
    masses = "One mass" if n == 1 else f"{n} masses"
    law = f", nonlinear ({facts.kind.replace('_', ' ')})" if model and not model.linear else ""
    if facts.added_mass:
        return f"{masses}{law}, free decays without and with a known added mass"
    return f"{masses}{law}, {f'driven by a known {facts.force}' if facts.forced else 'free decay'}"


def true_values(facts: Result) -> str:
    """List the true parameters, in SI units."""
    return ", ".join(f"{name} = {number(float(value))}" for name, value in facts.parameters.items())


def prior_words(facts: Result) -> str:
    """Describe the prior: the widths by kind of parameter."""
    if facts.prior is None:
        return "none"
    kinds = {parameter.kind for parameter in facts.known_model.parameters} if facts.known_model else set(facts.prior)
    widths = [f"{kind} {100 * float(facts.prior[kind]):g} %" for kind in facts.prior if kind in kinds - {"wrong"}]
    wrong = "; deliberately wrong by three of them" if facts.prior.get("wrong") else ""
    return f"nominal values, with standard deviations of {', '.join(widths)}{wrong}"


def at_most(row: Ranked) -> float:
    """Return the one-sided 95 % upper limit of the share of outlier fits (C. J. Clopper, E. S. Pearson, 1934)."""
    return 1.0 if row.lost == row.fits else float(beta.ppf(0.95, row.lost + 1, row.fits - row.lost))


def table_number(experiment: str) -> float:
    """Return the number of an experiment's table; infinite if it has none."""
    return float(Experiment(experiment).table.get("number", math.inf))


def table_name(experiment: str) -> str:
    """Return ``Table 3``, or the name of an experiment whose table has no number."""
    number = table_number(experiment)
    return f"Table {number:.0f}" if math.isfinite(number) else experiment


def slug(name: str) -> str:
    """Return a name as part of an address; a name that loses characters gets a hash of the whole name."""
    plain = re.sub(r"[^a-z0-9_.]+", "-", name.lower()).strip("-.")[:LONGEST]
    whole = re.fullmatch(r"[\w .,=()-]+", name, re.ASCII) and plain and len(name) <= LONGEST
    return plain if whole else hashed(plain, name)


def hashed(plain: str, name: str) -> str:
    """Append a hash of the whole name to an address."""
    return f"{plain}-{hashlib.sha256(name.encode()).hexdigest()[:8]}".lstrip("-")


def slugs(names: Sequence[str]) -> Mapping[str, str]:
    """Return different addresses for several names."""
    addresses: dict[str, str] = {}
    for name in names:
        plain = slug(name)
        addresses.setdefault(name, hashed(plain, name) if plain in addresses.values() else plain)
    return addresses
