"""The terms of an equation of motion, by hand."""

from dataclasses import replace

import pytest

from bench.config.experiment import expand
from bench.contract.estimate import Status
from bench.reporting.terms import kept_terms, terms_found, true_terms
from bench.scoring.row import Row
from bench.store.stored_cell import StoredCell
from bench.systems import SDOF, BoucWen, Chain, Duffing, Pendulum, VanDerPol

FREE: frozenset[int] = frozenset()


def test_terms_by_hand():
    """``x'' = -(k x + k3 x³ + c v)/m + f/m`` and ``x'' = (c - c3 x²) v/m - k x/m``."""
    assert true_terms(SDOF(), frozenset({0})) == ({"x", "v", "f"},)
    assert true_terms(Duffing(), FREE) == ({"x", "v", "x^3"},)
    assert true_terms(VanDerPol(), FREE) == ({"x", "v", "x^2 v"},)


def test_a_chain_of_two_pushed_on_the_second():
    """The first mass feels both springs and dampers, hence all four states; the second too, and the force."""
    states = {"x1", "x2", "v1", "v2"}
    assert true_terms(Chain(2), frozenset({1})) == (states, states | {"f2"})


@pytest.mark.parametrize("system", [Pendulum(), BoucWen()])
def test_what_is_no_polynomial_has_no_terms(system):
    assert true_terms(system, FREE) is None


def test_reading_what_a_method_kept():
    assert kept_terms("terms kept of 9: x, v, x^3") == ({"x", "v", "x^3"},)
    assert kept_terms("terms kept of 9: x, v; valid for frequencies below 1 Hz, half the sampling rate") == (
        {"x", "v"},
    )
    assert kept_terms("terms kept of 34: x1 (DOF 1); x2 (DOF 2); valid for frequencies below 1 Hz") == ({"x1"}, {"x2"})
    assert kept_terms("terms kept of 34: x1, v1 (DOF 1); none (DOF 2)") == ({"x1", "v1"}, frozenset())
    assert kept_terms("all is well") is None


def test_counting_right_and_too_many():
    scenario = expand(["method=sindy", "system=duffing"], multirun=False)[0].cell().scenario
    messages = [
        "terms kept of 9: x, v, x^3",
        "terms kept of 9: v, x, x^3",
        "terms kept of 9: x, v, x^3, x^2",
        "terms kept of 9: x",
    ]
    rows = tuple(Row(i, Status.OK, message) for i, message in enumerate(messages))
    stored = StoredCell("", {}, rows, {}, {}, {}, 0.0)
    assert terms_found(stored, scenario) == "exactly the right terms in 2 of 4, these and more in 1"
    none = replace(stored, rows=(Row(0, Status.DIVERGED, "terms kept of 9: x"),))
    assert terms_found(none, scenario) == "no terms stated"
