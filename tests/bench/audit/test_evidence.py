"""Audits against computations of their own: scipy's integrator or closed forms, differences, and plain statistics."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats
from scipy.integrate import solve_ivp

from bench.audit.claim import read_claim
from bench.audit.evidence import Audit, audit
from bench.audit.sentences import compared

KNOWN, UNKNOWN = ({"displacement": 1.0, "velocity": 0.0, "known": known} for known in (True, False))
FREE: dict[str, Any] = {
    "source": {"authors": "A. Author", "year": 2026, "title": "A title", "url": "https://example.org/claim"},
    "equation": "m*x'' + c*x' + k*x = 0", "initial_state": KNOWN, "times": {"from": 0, "to": 10, "n": 25},
    "noise": {"definition": "standard deviation", "value": 0.05}, "parameters": {"m": 1.0, "c": 0.4, "k": 8.0},
    "known": ["m"], "reported": [{"method": "fit", "quantity": "c", "value": 0.41}],
}  # fmt: skip


def audited(**changes: Any) -> Audit:
    return audit(read_claim("claim", {**FREE, **changes}, Path()))


def bounds(
    response: Callable[[np.ndarray, np.ndarray], np.ndarray], theta: Sequence[float], times: np.ndarray, sd: float
) -> np.ndarray:
    """The Cramér-Rao standard deviations, from a Jacobian by central differences."""
    theta = np.asarray(theta, float)
    steps = np.diag(1e-5 * np.maximum(np.abs(theta), 1.0))
    slopes = [(response(theta + h, times) - response(theta - h, times)).ravel() / (2 * np.sum(h)) for h in steps]
    jacobian = np.array(slopes).T / sd
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian))))


def oscillation(theta: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Free vibration below critical damping, by (c/m, k/m, x0, v0)."""
    c, k, x0, v0 = theta
    w = np.sqrt(k - c * c / 4)
    return np.asarray(np.exp(-c * t / 2) * (x0 * np.cos(w * t) + (v0 + c * x0 / 2) / w * np.sin(w * t)))


def test_twenty_random_times() -> None:
    """m 1, mu 4, k 400 at 20 uniform random times: bounds 0.308 and 8.73, so both methods are within one of them."""
    times = np.sort(np.random.default_rng(1).uniform(0.0, 1.0, 20))
    expected = bounds(oscillation, [4.0, 400.0, 1.0, 0.0], times, 0.05)
    numbers = {"PINN": (3.9254, 400.61), "least squares": (3.8747, 402.71)}
    result = audited(
        equation="x'' + mu*x' + k*x = 0", parameters={"mu": 4.0, "k": 400.0}, known=[], initial_state=UNKNOWN,
        times={"from": 0, "to": 1, "n": 20, "drawn": "default_rng(1)"},
        reported=[{"method": m, "quantity": q, "value": v} for m, values in numbers.items()
                  for q, v in zip(("mu", "k"), values, strict=True)],
    )  # fmt: skip
    assert [f.bound for f in result.findings[:2]] == pytest.approx(expected[:2], rel=1e-6)
    assert expected[:2] == pytest.approx([0.308, 8.73], rel=2e-3)
    assert [f.verdict for f in result.findings] == ["within"] * 4
    undecided = "one draw does not determine which is more accurate, 'PINN' and 'least squares'"
    assert list(map(compared, result.rivals)) == [f"for mu: {undecided}", f"for k: {undecided}"]
    # the chance of an error at least so large, from the normal distribution, the last digit printed allowed for
    chance = 2 * stats.norm.sf((0.1253 - 0.00005) / expected[0])
    assert result.findings[2].larger == pytest.approx(chance, abs=0.005)  # three standard errors of 100,000 draws


@pytest.mark.parametrize(
    ("velocity", "known", "value"),
    [(0.0, True, 0.0103), (0.0, False, 0.0187), (-0.05, True, 0.0102), (-0.05, False, 0.0189)],
)
def test_ten_times_of_a_known_mass_and_stiffness(velocity: float, known: bool, value: float) -> None:
    """m 1, c 0.1, k 1: the bound on c, from the velocity that the source states, and from that of its solution."""

    def response(theta: np.ndarray, t: np.ndarray) -> np.ndarray:
        return oscillation(np.array([theta[0], 1.0, *(theta[1:] if len(theta) > 1 else (1.0, velocity))]), t)

    times = np.arange(0.5, 10.0)
    expected = bounds(response, [0.1] if known else [0.1, 1.0, velocity], times, 0.05)[0]
    result = audited(
        parameters={"m": 1.0, "c": 0.1, "k": 1.0}, known=["m", "k"], times=times.tolist(),
        initial_state={"displacement": 1.0, "velocity": velocity, "known": known},
        reported=[{"method": "PINN", "quantity": "c", "value": 0.0922}],
    )  # fmt: skip
    assert result.findings[0].bound == pytest.approx(expected, rel=1e-6)
    assert expected == pytest.approx(value, abs=6e-5)


def test_forty_times_of_a_known_stiffness() -> None:
    """m 1, k 400, mu 4 of even times: 0.114."""
    times = np.linspace(0.0, 1.0, 40)
    expected = bounds(lambda th, t: oscillation(np.array([th[0], 400.0, 1.0, 0.0]), t), [4.0], times, 0.04)[0]
    result = audited(
        parameters={"m": 1.0, "c": 4.0, "k": 400.0}, known=["m", "k"], times={"from": 0, "to": 1, "n": 40},
        noise={"definition": "standard deviation", "value": 0.04},
    )  # fmt: skip
    assert result.findings[0].bound == pytest.approx(expected, rel=1e-6)
    assert expected == pytest.approx(0.114, abs=5e-4)


def test_two_masses_between_walls_under_a_step() -> None:
    """m 20, 10; k 2e3, 1e3, 5e3; c 100, 110, 120 unknown: 5.8, 8.5 and 20.9, by scipy's integrator."""
    m, k = np.diag([20.0, 10.0]), np.array([[3e3, -1e3], [-1e3, 6e3]])

    def response(c: np.ndarray, t: np.ndarray) -> np.ndarray:
        damping = np.array([[c[0] + c[1], -c[1]], [-c[1], c[1] + c[2]]])
        inverse, push = np.linalg.inv(m), np.array([1.0, 0.0])

        def rate(_: float, s: np.ndarray) -> np.ndarray:
            return np.concatenate([s[2:], inverse @ (push - damping @ s[2:] - k @ s[:2])])

        return 1e5 * solve_ivp(rate, (0, t[-1]), np.zeros(4), t_eval=t, rtol=1e-11, atol=1e-14).y[:2]

    expected = bounds(response, [100.0, 110.0, 120.0], np.linspace(0.0, 2.0, 1001), 1.5)
    assert expected == pytest.approx([5.8, 8.5, 20.9], abs=0.08)
    result = audited(
        equation=["m1*x1'' + c1*x1' + c2*(x1' - x2') + k1*x1 + k2*(x1 - x2) = f1",
                  "m2*x2'' + c2*(x2' - x1') + c3*x2' + k2*(x2 - x1) + k3*x2 = 0"],
        parameters={"m1": 20, "m2": 10, "k1": 2e3, "k2": 1e3, "k3": 5e3, "c1": 100, "c2": 110, "c3": 120},
        known=["m1", "m2", "k1", "k2", "k3"], force="1", times={"from": 0, "to": 2, "n": 1001},
        noise={"definition": "standard deviation", "value": 1.5e-5},
        initial_state={"displacement": [0, 0], "velocity": [0, 0], "known": True},
        reported=[{"method": "network", "quantity": q} for q in ("c1", "c2", "c3")],
    )  # fmt: skip
    assert [f.bound for f in result.findings] == pytest.approx(expected, rel=1e-4)
    assert {f.verdict for f in result.findings} == {"no number"}


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_nonlinear_equation_with_velocities(sign: float) -> None:
    """A Duffing oscillator under a cosine; with a negative linear spring, too."""
    p, times = np.array([sign, 0.3, 1.0]), np.linspace(0.0, 8.0, 30)

    def response(theta: np.ndarray, t: np.ndarray) -> np.ndarray:
        k, c, b = theta

        def rate(s: float, y: np.ndarray) -> list[float]:
            return [y[1], 0.5 * np.cos(1.2 * s) - c * y[1] - k * y[0] - b * y[0] ** 3]

        return np.asarray(solve_ivp(rate, (0, t[-1]), [1.0, 0.0], t_eval=t, rtol=1e-11, atol=1e-13).y)

    expected = bounds(response, p, times, 0.02)
    result = audited(
        equation="x'' + c*x' + k*x + b*x**3 = f", parameters=dict(zip("kcb", p.tolist(), strict=True)), known=[],
        force="0.5*cos(1.2*t)", times=times.tolist(), measured=["x", "v"],
        noise={"definition": "standard deviation", "value": 0.02},
        reported=[{"method": "fit", "quantity": q} for q in "kcb"],
    )  # fmt: skip
    assert [f.bound for f in result.findings] == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize(
    ("definition", "value", "of"),
    [
        ("variance", 4e-4, lambda x: 0.02), ("half-width", 0.03, lambda x: 0.03 / np.sqrt(3)),
        ("snr db", 20, lambda x: 0.1 * np.sqrt(np.mean(x**2))),
        ("snr db of the variance", 20, lambda x: 0.1 * np.std(x)),
        ("snr db of the peak", 40, lambda x: 0.01 * np.max(abs(x))),
        ("percent of the rms", 5, lambda x: 0.05 * np.sqrt(np.mean(x**2))),
        ("percent of the standard deviation", 5, lambda x: 0.05 * np.std(x)),
        ("percent of the largest value", 5, lambda x: 0.05 * np.max(abs(x))),
    ],
)  # fmt: skip
def test_definitions_of_noise(definition: str, value: float, of: Callable[[np.ndarray], float]) -> None:
    clean = oscillation(np.array([0.4, 8.0, 1.0, 0.0]), np.linspace(0.0, 10.0, 25))
    sizes = [audited(noise={"definition": d, "value": v}).findings[0].bound
             for d, v in ((definition, value), ("standard deviation", of(clean)))]  # fmt: skip
    assert sizes[0] == pytest.approx(sizes[1], rel=1e-9)


@pytest.mark.parametrize("draws", [1, 25])
@pytest.mark.parametrize("form", ["value", "percent error", "absolute error", "rmse"])
def test_scores_of_an_efficient_estimator(form: str, draws: int) -> None:
    """Half normal, its means, and chi; of 25 draws by the central limit."""
    finding = audited(
        reported=[{"method": "fit", "quantity": "c", "value": 0.4, "form": form, "draws": draws}]
    ).findings[0]
    scale = finding.bound * (100 / 0.4 if form == "percent error" else 1.0)
    if draws == 1 or form == "value":
        expected = scale / np.sqrt(draws) * stats.halfnorm.ppf([0.025, 0.5, 0.975])
    elif form == "rmse":
        expected = scale / np.sqrt(draws) * stats.chi(draws).ppf([0.025, 0.5, 0.975])
    else:
        expected = scale * (np.sqrt(2 / np.pi) + np.sqrt((1 - 2 / np.pi) / draws) * stats.norm.ppf([0.025, 0.5, 0.975]))
    assert [finding.low, finding.median, finding.high] == pytest.approx(expected, rel=0.03, abs=0.001 * scale)


def test_a_least_squares_fit_scores_as_an_efficient_estimator() -> None:
    """Three hundred noisy records, fitted by scipy: their displacement errors have the stated quantiles."""
    from scipy.optimize import least_squares

    t, dense, rng = np.linspace(0.0, 10.0, 25), np.linspace(0.0, 10.0, 1000), np.random.default_rng(5)
    truth = np.array([0.4, 8.0, 1.0, 0.0])
    errors = []
    for _ in range(300):
        y = oscillation(truth, t) + 0.02 * rng.standard_normal(t.size)
        fit = least_squares(lambda th, y=y: oscillation(th, t) - y, truth).x
        errors.append(np.sqrt(np.mean((oscillation(fit, dense) - oscillation(truth, dense)) ** 2)))
    row = {"method": "fit", "quantity": "x", "value": 0.01, "form": "rmse"}
    noise = {"definition": "standard deviation", "value": 0.02}
    finding = audited(initial_state=UNKNOWN, noise=noise, reported=[row]).findings[0]
    assert np.median(errors) == pytest.approx(finding.median, rel=0.08)
    assert np.mean([finding.low <= error <= finding.high for error in errors]) == pytest.approx(0.95, abs=0.04)
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(finding.bound, rel=0.08)


@pytest.mark.parametrize(
    ("value", "verdict"), [(0.41, "within"), (0.6, "larger"), (0.40000, "within"), (0.4000004, "smaller")]
)
def test_where_a_number_falls(value: float, verdict: str) -> None:
    """The bound is 0.032. As 0.4 is printed, it may be off by 0.05, but 0.4000004 is nearer than one draw in 100."""
    assert audited(reported=[{"method": "fit", "quantity": "c", "value": value}]).findings[0].verdict == verdict


@pytest.mark.parametrize(
    ("values", "said"),
    [
        (
            (0.41, 0.42, 0.9),
            "for c: one draw does not determine which is more accurate, 'a and e' and 'b'; the errors of 'd' are "
            "larger",
        ),
        (
            (0.41, 0.8, 0.9),
            "for c: the error of 'a and e' is not larger than those of an efficient estimator; the errors of 'b' and "
            "'d' are larger",
        ),
        (
            (0.7, 0.8, 0.9),
            "for c: the errors of 'a and e' and 'b' and 'd' are larger than those of an efficient estimator; noise "
            "does not explain them",
        ),
    ],
)
def test_which_comparisons_one_draw_decides(values: Sequence[float], said: str) -> None:
    """The bound is 0.032."""
    rows = [
        {"method": name, "quantity": "c", "value": value}
        for name, value in zip(("a and e", "b", "d"), values, strict=True)
    ]
    assert [compared(rivals) for rivals in audited(reported=rows).rivals] == [said]


def test_what_free_vibration_does_not_determine() -> None:
    result = audited(known=[], reported=[{"method": "fit", "quantity": q, "value": 1} for q in ("m", "k/m", "k/c")])
    assert [f.verdict == "not identifiable" for f in result.findings] == [True, False, False]
    assert "multiplied by one constant" in " ".join(result.findings[0].why)
    weighed = audited(
        known=[], given={"prior": {"m": {"percent": 2}}}, reported=[{"method": "fit", "quantity": "m", "value": 1.01}]
    )
    assert weighed.findings[0].verdict == "decided by the prior"
    assert weighed.findings[0].bound == pytest.approx(0.02)
    assert weighed.findings[0].prior_share == pytest.approx(1.0)


def test_without_noise_only_the_bias_is_stated() -> None:
    finding = audited(noise={"definition": "none"}).findings[0]
    assert (finding.verdict, finding.score) == ("bias only", pytest.approx(0.01))
    assert np.isnan(finding.median)


def test_a_published_solution_of_another_equation_is_seen(tmp_path: Path) -> None:
    """exp(-0.3 t) cos(3 t) obeys x'' + 0.6 x' + 9.09 x = 0 from the velocity -0.3: not what is stated of it."""
    t = np.linspace(0.0, 5.0, 50)
    columns = [t, np.exp(-0.3 * t) * np.cos(3 * t), oscillation(np.array([0.6, 9.0, 1.0, 0.0]), t)]
    noisy = columns[2] + 0.01 * np.random.default_rng(0).standard_normal(50)
    np.savetxt(
        tmp_path / "data.csv", np.array([*columns, noisy]).T, delimiter=",", header="t,exact,right,noisy", comments=""
    )
    content = {
        **FREE, "equation": "x'' + 2*g*x' + w**2*x = 0", "parameters": {"g": 0.3, "w": 3.0}, "known": ["g", "w"],
        "times": {"column": "t"}, "noise": {"definition": "standard deviation", "value": 0.01},
        "data": {"file": "data.csv", "time": "t", "exact": "exact", "x": "noisy"},
        "cases": {"right": {"data": {"exact": "right"}}},
        "reported": [{"method": "fit", "quantity": "x", "form": "rmse", "case": case} for case in ("", "right")],
    }  # fmt: skip
    checks = {(case, check.what): check for case, check in audit(read_claim("claim", content, tmp_path)).consistency}
    wrong = checks["", "solution"]
    assert not wrong.agrees
    assert wrong.fitted["w"][0] ** 2 == pytest.approx(9.09, rel=1e-5)
    assert wrong.fitted["x'(0)"][0] == pytest.approx(-0.3, rel=1e-4)
    assert checks["right", "solution"].agrees
    assert checks["", "samples"].agrees
