"""What data can tell, found by machine, against what is derived by hand."""

from __future__ import annotations

import itertools
import math
import random
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pytest
from more_systems import BoucWen, Coupled
from scipy.linalg import subspace_angles
from scipy.optimize import curve_fit

sympy = pytest.importorskip("sympy")

from bench.commands.main import main  # noqa: E402
from bench.information import structural  # noqa: E402
from bench.information.fisher import compute_bound, information  # noqa: E402
from bench.information.profile import THRESHOLD, _Likelihood, profiles  # noqa: E402
from bench.information.series import Series, rational, series_ops  # noqa: E402
from bench.information.structural import Structure, readable, structure, structure_of  # noqa: E402
from bench.reporting.identifiability import (  # noqa: E402
    BY_PRIOR,
    FROM_DATA,
    NOT,
    PRACTICALLY_NOT,
    WITH_PRIOR,
    verdict,
)
from bench.scenario.scenario import Scenario  # noqa: E402
from bench.scenario.truth import closed_form  # noqa: E402
from bench.systems import MASS, SDOF, STIFFNESS, Chain, Duffing, Parameter, Quantity, System  # noqa: E402

CHAIN_TRUE = {"m1": 1.0, "m2": 0.8, "c1": 0.2, "c2": 0.15, "k1": 12.0, "k2": 9.0}
CHAIN_FREE = Scenario(
    "chain", CHAIN_TRUE, ((1.0, 0.0), (0.0, 0.0)), 20.0, 4.0, samples=40, initial_state="unknown", options={"n": 2}
)
DUFFING_FREE = Scenario("duffing", {"m": 1.0, "c": 0.4, "k": 8.0, "k3": 5.0}, ((1.0,), (0.0,)), 20.0, 4.0, samples=40)
ONES = {1: (1, 1, 1), 2: (1,) * 6, 3: (1,) * 9}


@dataclass(frozen=True)
class Pair(System):
    """Two oscillators that do not know of each other, ``m_i a_i + k_i x_i = f_i``."""

    name: ClassVar[str] = "pair"
    linear: ClassVar[bool] = True

    @property
    def n_dof(self) -> int:
        return 2

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        masses = (Parameter(f"m{i}", "kg", "mass", MASS) for i in (1, 2))
        return (*masses, *(Parameter(f"k{i}", "N/m", "stiffness", STIFFNESS) for i in (1, 2)))

    def residual(self, p, x, v, a, f, z, ops):
        return [p[f"m{i + 1}"] * a[i] + p[f"k{i + 1}"] * x[i] - f[i] for i in (0, 1)]

    @property
    def groups(self) -> tuple[Quantity, ...]:
        return ()


def exponents(found: Structure) -> np.ndarray:
    """The found groups as rows over the parameters."""
    return np.array([group.vector(found.names) for group in found.groups]).reshape(-1, len(found.names))


def same_span(a: Any, b: Any) -> bool:
    a, b = np.atleast_2d(np.array(a, float)), np.atleast_2d(np.array(b, float))
    return a.shape == b.shape and bool(np.max(subspace_angles(a.T, b.T)) < 1e-6)


@pytest.mark.parametrize("told", ["known", "unknown"])
def test_free_vibration_tells_an_oscillator_its_two_ratios(told: Any) -> None:
    """``x'' = -(c/m) x' - (k/m) x``: the response depends on c/m and k/m alone, and its poles tell both.

    Their sum is -c/m, their product k/m; both show in any response that excites the poles, known start or not.
    So is every product of powers whose exponents add up to nothing: sqrt(k/m), and c / sqrt(k m).
    """
    found = structure(SDOF(), initial_state=told)
    assert found.rank == 2
    assert found.scalings == ((1, 1, 1),)
    assert {readable(group) for group in found.groups} == {"c/m", "k/m"}
    assert [found.identifiable(q) for q in SDOF().quantities] == [False, False, False, True, True, True, True]


@pytest.mark.parametrize("told", ["known", "unknown"])
def test_a_known_force_sets_the_scale(told: Any) -> None:
    """``1 / (m s² + c s + k)`` is the transfer function: its three coefficients are the parameters themselves."""
    found = structure(SDOF(), initial_state=told, forced=(0,))
    assert (found.rank, found.scalings) == (3, ())
    assert all(found.identifiable(q) for q in SDOF().quantities)


def test_a_cubic_spring_adds_one_ratio() -> None:
    """``x'' + (c/m) x' + (k/m) x + (k3/m) x³ = 0``, and x itself is measured: three coefficients, all told."""
    found = structure(Duffing(), initial_state="unknown")
    assert {readable(group) for group in found.groups} == {"c/m", "k/m", "k3/m"}
    assert found.scalings == ((1, 1, 1, 1),)
    assert structure(Duffing(), initial_state="unknown", forced=(0,)).rank == 4


@pytest.mark.parametrize("n", [1, 2, 3])
def test_a_chain_measured_everywhere_is_told_up_to_one_scale(n: int) -> None:
    """With all displacements, ``a = -M⁻¹(C v + K x)`` is told entry by entry; from it every parameter over m1.

    Row 1 gives k2/m1 and (k1 + k2)/m1, row 2 gives k2/m2, hence m2/m1, and so on down the chain; likewise damping.
    """
    found = structure(Chain(n), initial_state="unknown")
    assert (found.rank, found.scalings) == (3 * n - 1, (ONES[n],))
    assert same_span(exponents(found), [g.vector(found.names) for g in Chain(n).groups])


def test_the_first_mass_alone_tells_only_the_poles_from_an_unknown_start() -> None:
    """Two masses, only x1 measured, free, start unknown: ``X1(s) = N(s)/D(s)`` with D the characteristic polynomial.

    N is of degree 3 and its four coefficients are an invertible function of the four unknown initial values, so it
    tells nothing of the parameters. D has four coefficients: four functions of six parameters. One of them is a
    product of powers, D(0) = k1 k2 / (m1 m2), the product of the squared natural frequencies; the others are sums,
    such as (c1 + c2)/m1 + c2/m2. One lost direction is the scale, the other no scaling at all.
    """
    found = structure(Chain(2), (0,), "unknown")
    assert found.rank == 4
    assert [readable(group) for group in found.groups] == ["k1*k2/(m1*m2)"]
    assert found.scalings == (ONES[2],)
    assert "1 more way" not in " ".join(found.sentences())
    assert any("one more way" in line for line in found.sentences())


def _transfer_rank(forced: bool) -> int:
    """The rank of the coefficients of D (or of the transfer function to x1) by the parameters, from determinants."""
    m1, m2, c1, c2, k1, k2, s = sympy.symbols("m1 m2 c1 c2 k1 k2 s", positive=True)
    z = sympy.Matrix([[m1 * s**2 + (c1 + c2) * s + k1 + k2, -c2 * s - k2], [-c2 * s - k2, m2 * s**2 + c2 * s + k2]])
    denominator = sympy.Poly(z.det(), s)
    told = [c / denominator.LC() for c in denominator.all_coeffs()[1:]]
    if forced:
        told += [c / denominator.LC() for c in sympy.Poly(z[1, 1], s).all_coeffs()]
    at = dict(zip((m1, m2, c1, c2, k1, k2), map(sympy.Rational, (3, 5, 7, 11, 13, 17)), strict=True))
    return int(sympy.Matrix(told).jacobian(list(at)).subs(at).rank())


@pytest.mark.parametrize("forced", [False, True])
def test_the_first_mass_alone_tells_what_its_transfer_function_does(forced: bool) -> None:
    """With a force on mass 1 the numerator ``(m2 s² + c2 s + k2)/(m1 m2)`` is told too: seven coefficients, rank 6."""
    rank = structure(Chain(2), (0,), "unknown", (0,) if forced else ()).rank
    assert rank == _transfer_rank(forced) == (6 if forced else 4)


def test_the_start_matters_where_it_leaves_a_part_at_rest() -> None:
    """Two separate oscillators: each is told k_i/m_i if it moves, and nothing of it is told if it rests, known so."""
    moving = structure(Pair())
    assert {readable(group) for group in moving.groups} == {"k1/m1", "k2/m2"}
    assert same_span(moving.scalings, [(1, 0, 1, 0), (0, 1, 0, 1)])
    resting = structure(Pair(), start=((1.0, 0.0), (0.0, 0.0)))
    assert [readable(group) for group in resting.groups] == ["k1/m1"]
    assert resting.rank == 1
    assert "m2 does not change the response at all" in resting.sentences()
    assert {readable(group) for group in structure(Pair(), (1,), forced=(1,)).groups} == {"m2", "k2"}


def test_hidden_states_and_motion_dependent_inertia_work_too() -> None:
    """Bouc-Wen of this kind and the cart with an arm are homogeneous in their parameters: free, all but the scale."""
    assert structure(BoucWen()).scalings == ((1, 1, 1),)
    assert structure(BoucWen(), forced=(0,)).rank == 3
    assert structure(Coupled()).scalings == ((1, 1, 1),)
    at_rest = structure(BoucWen(), start=((1.0,), (0.0,)))  # its spring is z, which starts at 0: nothing ever moves
    assert at_rest.at_start
    assert at_rest.rank == 0
    switching = structure(BoucWen(), None, "unknown", start=((1.0,), (0.0,)))  # |v| has no slope at v = 0
    assert not switching.at_start


def test_the_exact_derivatives_are_those_of_symbolic_lie_derivatives() -> None:
    """Duffing from a told start: y and its first five time derivatives by the chain rule in sympy, by log-parameter."""
    p = dict(zip(Duffing().names, map(sympy.Integer, (2, 3, 5, 7)), strict=True))
    symbols, (x, v) = {name: sympy.Symbol(name) for name in p}, sympy.symbols("x v")
    m, c, k, k3 = symbols.values()
    lie, expected = x, []
    for order in range(6):
        at = {symbols[name]: value for name, value in p.items()} | {x: sympy.Rational(3, 2), v: sympy.Integer(-1)}
        expected.append([(lie.diff(s) * s).subs(at) / sympy.factorial(order) for s in symbols.values()])
        lie = lie.diff(x) * v - lie.diff(v) * (c * v + k * x + k3 * x**3) / m

    class Drawn(random.Random):
        values = iter((2, 3, 5, 7))

        def randint(self, a: int, b: int) -> int:
            return next(self.values)

    rows = structural._jacobian(Duffing(), (0,), "known", (), ((1.5,), (-1.0,)), Drawn())
    found = [[sympy.Rational(int(e.numerator), int(e.denominator)) for e in row] for row in rows[:6]]
    assert found == expected


def test_functions_of_series_obey_their_laws() -> None:
    """At u = 2/3 + 5t: exp has coefficients e^u 5^k/k!, sin² + cos² = 1, tanh' = 5 (1 - tanh²), all exactly."""
    u = Series(np.array([[rational(2) / 3, rational(1)], *[[rational(5 * (k == 0)), rational(0)] for k in range(5)]]))
    ops = series_ops(random.Random(1))
    e = ops.exp(u).c
    assert [row[0] for row in e] == [e[0, 0] * rational(5**k) / math.factorial(k) for k in range(6)]
    assert [row[1] for row in e] == [row[0] for row in e]  # d exp(u) / du = exp(u)
    one = (ops.sin(u) ** 2 + ops.cos(u) ** 2).c
    assert one[0, 0] == 1
    assert not np.any(one[1:])
    assert not np.any(one[0, 1:])
    assert [row[1] for row in ops.sin(u).c] == [row[0] for row in ops.cos(u).c]
    tanh = ops.tanh(u)
    law = 5 * (1 - tanh**2)
    assert [(k + 1) * tanh.c[k + 1, 0] for k in range(5)] == [law.c[k, 0] for k in range(5)]
    assert [row[1] for row in tanh.c] == [row[0] for row in (1 - tanh**2).c]
    assert np.all((u / u).c == (u**0 + 0 * u).c)
    with pytest.raises(TypeError, match="whole powers"):
        u**0.5


@pytest.mark.parametrize(
    "scenario",
    [Scenario("sdof", {"m": 1.0, "c": 0.4, "k": 8.0}, ((1.0,), (0.0,)), 20.0), CHAIN_FREE, DUFFING_FREE],
    ids=lambda s: s.system,
)
def test_structure_and_fisher_information_lose_the_same_directions(scenario: Scenario) -> None:
    bound = compute_bound(scenario)
    found = structure_of(scenario)
    assert same_span(found.scalings, bound.null_space)
    assert {q.name: found.identifiable(q) for q in scenario.make_system().quantities} == bound.identifiable


def test_structure_and_fisher_information_agree_on_one_sensor() -> None:
    """Rank 4 of 6 by hand, see above: the information loses two directions, and tells D(0) all the same."""
    told, found = information(CHAIN_FREE, 0, (0,)), structure_of(CHAIN_FREE, (0,))
    assert len(told.null_space) == 2
    assert told.identifiable(found.groups[0])
    assert told.condition(with_prior=False)[1] == 2
    everywhere = information(CHAIN_FREE).variance(found.groups[0])
    assert everywhere < told.variance(found.groups[0]) < math.inf


def test_verdicts_follow_from_the_bound_and_the_priors_share() -> None:
    """At 20 dB, k/m is known to 0.5 % and c/m to 3.46 % (protocol), the mass to 2 % from the prior.

    Of the variance of k, 2² of 2² + 0.5² is the prior's: it decides. Of c, 2² of 2² + 3.46²: a quarter, so it does not.
    Forty decibels lower errors are 100 times larger: 50 % for k/m, and 346 % for c/m.
    """
    assert [verdict(False, 0.0206, 4.0 / 4.25), verdict(False, 0.04, 4.0 / 15.97)] == [BY_PRIOR, WITH_PRIOR]
    assert [verdict(True, sd, 0.0) for sd in (0.5, 3.46, math.inf)] == [FROM_DATA, PRACTICALLY_NOT, PRACTICALLY_NOT]
    assert verdict(False, math.inf, 0.0) == NOT


def test_profiles_are_flat_or_end_where_a_curve_fit_says(reference: Scenario) -> None:
    """k/m and c/m against scipy's curve_fit of the closed form; m can be anything, c and k with it.

    With the noise level profiled out, n/2 log(rss) rises by 1.92 where ``z² = n (exp(2 * 1.92 / n) - 1)`` with z the
    distance over sqrt((n - p)/n) of the fit's standard error, to first order; at 40 dB that is all there is.
    """
    scenario = replace(reference, snr_db=40.0)
    system, n = SDOF(), scenario.samples
    names = ("m", "k_over_m", "c_over_m")
    quantities = [system.quantity(name) for name in names]
    found = profiles(scenario, structure_of(scenario), information(scenario), quantities)
    assert np.max(found[0].drop) < 1e-6
    assert found[0].interval == (0.0, math.inf)
    record = scenario.replicates(0, 1)[0][0].records[0].channels[0]

    def response(t: np.ndarray, *ratios: float) -> np.ndarray:
        return closed_form({"m": 1.0, "k": ratios[0], "c": ratios[1]}, 1.0, 0.0, t)

    values, covariance = curve_fit(response, record.times, record.values, p0=(8.0, 0.4))
    reach = math.sqrt(n * math.expm1(2 * THRESHOLD / n) * (n - 2) / n)
    for profile, value, sd in zip(found[1:], values, np.sqrt(np.diag(covariance)), strict=True):
        assert profile.estimate == pytest.approx(value, rel=1e-5)
        low, high = profile.interval
        assert (high - low) / 2 == pytest.approx(reach * sd, rel=0.02)


def test_the_fit_is_a_maximum_of_the_likelihood_with_every_noise_level_profiled_out() -> None:
    """Two channels of unequal noise: no step from the fitted point raises -sum n log(rss)/2, written out here."""
    record = CHAIN_FREE.replicates(0, 1)[0][0].records[0]
    first = np.log(list(CHAIN_TRUE.values()))
    likelihood = _Likelihood(Chain(2), record, first)
    start = np.concatenate([CHAIN_FREE.start.displacement, CHAIN_FREE.start.velocity]) / likelihood.scale
    best, height = likelihood.maximise(np.concatenate([first, start]), np.eye(10)[:, 1:])

    def written_out(phi: np.ndarray) -> float:
        halves = np.split(likelihood.residuals(phi), 2)
        return -sum(half.size / 2 * math.log(float(np.mean(half**2))) for half in halves)

    assert height == pytest.approx(written_out(best), abs=1e-8)
    for i, size in itertools.product(range(1, 10), (-1e-3, 1e-3)):
        assert written_out(best + size * np.eye(10)[i]) < height


def test_the_command_prints_the_verdicts(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["identifiability"]) == 0
    text = capsys.readouterr().out
    assert "m, c, k may all be multiplied by one constant" in text
    assert "identifiable: c/m, k/m, and any product of their powers" in text
    words = {
        line.split()[0]: " ".join(line.split()[3:]) for line in text.splitlines() if line[:2] in ("m ", "c ", "k/")
    }
    assert words == {"m": BY_PRIOR, "c": WITH_PRIOR, "k/m": FROM_DATA}
    assert "m and k +0.97" in text  # 0.02 / sqrt(0.02² + 0.00496²), with the protocol's bound on k/m
    assert max(map(len, text.splitlines())) <= 100
