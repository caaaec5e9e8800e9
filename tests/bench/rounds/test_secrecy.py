"""Attacks that an attacker with the repository and the folder of a round would try."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import kstest

from bench.config.files import read_yaml
from bench.errors import InputError
from bench.rounds.draw import draw_round, draw_scenario, with_truth
from bench.rounds.folder import TRUTH
from bench.rounds.secret import SecretStream, derived_key
from bench.scenario.scenario import Scenario

RANGES = read_yaml("", "round")
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


def scenarios(kind: str, n: int, seed: int = 5) -> Iterator[Scenario]:
    """Scenarios of a kind as they are drawn, without their data, which take longer."""
    number = 0
    while n:
        number += 1
        try:
            yield draw_scenario("P001", kind, RANGES, SecretStream(derived_key(seed, number)))
            n -= 1
        except InputError:
            continue


def unexplained(kind: str, n: int = 150) -> float:
    """Return the standard deviation of ln(k/m) that a regression on all published logarithms leaves."""
    published, secret = [], []
    for s in scenarios(kind, n):
        force = s.force
        pushed = [force.amplitude, force.low_hz or 0, force.high_hz or 0, force.length_s or 0] if force else []
        numbers = [s.duration, s.samples, *np.ravel(s.initial), *pushed]
        published.append([1.0, *(math.log(abs(x)) if x else 0.0 for x in numbers), *(float(x == 0) for x in pushed)])
        secret.append(math.log(s.parameters["k"] / s.parameters["m"]))
    columns, target = np.array(published), np.array(secret)
    coefficients, *_ = np.linalg.lstsq(columns, target, rcond=None)
    rank = np.linalg.matrix_rank(columns)
    return float(np.sqrt(np.sum((target - columns @ coefficients) ** 2) / (n - rank)))


@pytest.mark.parametrize("kind", ["free decay", "forced"])
def test_no_product_of_powers_of_published_numbers_is_the_natural_frequency(kind: str) -> None:
    """A record is 1 to 30 periods long, and a force is made for a frequency off by up to exp(0.4), an sd of 0.46."""
    assert unexplained(kind) > 0.2


def test_no_number_of_the_truth_stands_in_the_folder(six: tuple[Path, Path]) -> None:
    """To six digits. A true value, its square root or its inverse, or a bound."""
    folder, secret = six
    numbers = np.sort([abs(float(word)) for path in sorted(folder.rglob("*")) if path.is_file()
                       for word in NUMBER.findall(path.read_text())])  # fmt: skip
    rows = [line.split(",") for line in (secret / TRUTH).read_text().splitlines()[1:]]
    for value, bound in ((float(row[2]), float(row[3])) for row in rows):
        for guess in (value, math.sqrt(value), math.sqrt(value) / (2 * math.pi), 1 / value, bound, bound / value):
            place = np.searchsorted(numbers, guess)
            near = numbers[max(place - 1, 0) : place + 1]
            assert not np.any(np.abs(near / guess - 1) < 1e-7), guess


def test_seed_and_kind_stand_nowhere_in_the_folder(six: tuple[Path, Path]) -> None:
    folder, secret = six
    seed = json.loads((secret / "secret.json").read_text())["seed"]
    assert len(seed) * 4 >= 256
    for path in folder.rglob("*"):
        text = path.read_text() if path.is_file() else ""
        assert seed not in text
        assert path.name == "README.md" or "coloured" not in text
    assert (secret.stat().st_mode & 0o077) == 0


def test_public_seeds_do_not_make_the_data_again() -> None:
    """The harness with a seed of 0 to 99, or the secret itself, and the true scenario: other noise."""
    scenario = next(scenarios("free decay", 1))
    secret = with_truth("P001", "free decay", scenario, derived_key(3, "data"))
    published = secret.problem.records[0].channels[0].values
    for seed in (*range(100), 3, derived_key(3, "data")):
        guessed = scenario.maker(seed)(0)[0].records[0].channels[0].values
        assert guessed.shape != published.shape or not np.any(np.isclose(guessed, published, rtol=1e-7, atol=0.0))


def test_the_same_seed_gives_the_same_round_and_a_changed_bit_another() -> None:
    first, again, other = (draw_round(seed, 2, RANGES) for seed in (2**200, 2**200, 2**200 + 1))
    assert [problem.truth for problem in first] == [problem.truth for problem in again]
    assert not {v for p in first for v in p.truth.values()} & {v for p in other for v in p.truth.values()}


@pytest.mark.parametrize(("name", "arguments", "law"), [
    ("random", (), ("uniform",)), ("standard_normal", (), ("norm",)), ("chisquare", (5.0,), ("chi2", (5.0,))),
])  # fmt: skip
def test_streams_have_their_distributions_and_none_is_that_of_another_purpose(
    name: str, arguments: tuple[float, ...], law: tuple[str]
) -> None:
    """Kolmogorov and Smirnov of 20,000 numbers; neighbours and streams of other purposes are uncorrelated."""
    streams = [SecretStream(derived_key(1, purpose)) for purpose in ("noise", "parameters")]
    first, other = (getattr(stream, name)(*arguments, 20_000) for stream in streams)
    assert kstest(first, *law).pvalue > 1e-3
    for a, b in ((first, other), (first[1:], first[:-1])):
        assert abs(np.corrcoef(a, b)[0, 1]) < 5 / math.sqrt(20_000)
