"""Compiled output error: predictions, derivatives and fitted starts are those of the plain one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench import Channel, Force, OutputError, Problem, Record
from bench.likelihood.compiled_model import CompiledOutputError, compiled_output_error
from bench.systems import BoucWen, System
from bench.systems.sums import sum_from

T = np.linspace(0.1, 6.0, 60)
KNOTS = np.linspace(0.0, 6.0, 40)
SYSTEMS: dict[str, tuple[System, dict[str, float]]] = {
    "Duffing": (sum_from("sdof+cubic"), {"m": 1.2, "c": 0.4, "k": 9.0, "k3": 6.0}),
    "friction": (sum_from("sdof+coulomb", smoothing_velocity=0.05), {"m": 1.0, "c": 0.2, "k": 9.0, "mu": 0.3}),
    "hidden state": (BoucWen(), {"m": 1.1, "c": 0.35, "k": 4.5, "kz": 7.0, "beta": 1.1, "gamma": 0.8}),
}


def problem(system: System, forced: bool) -> Problem:
    forces = (Force(KNOTS, np.cos(2.0 * KNOTS)),) if forced else ()
    channels = (
        Channel(T, np.cos(3.0 * T), offset=True),
        Channel(T[::2] + 0.01, np.sin(T[::2]), "velocity"),
        Channel(T[5:], np.sin(T[5:]), "acceleration"),
    )
    return Problem(system, (Record(channels, forces), Record((Channel(T, np.sin(3.0 * T)),))))


@pytest.mark.parametrize("forced", [False, True])
@pytest.mark.parametrize("name", SYSTEMS)
def test_predictions_are_those_of_the_plain_model(name: str, forced: bool) -> None:
    system, p = SYSTEMS[name]
    ours, plain = (kind(problem(system, forced)) for kind in (compiled_output_error, OutputError))
    assert isinstance(ours, CompiledOutputError)
    rng = np.random.default_rng(1)
    theta = np.log([p[n] for n in plain.free])
    thetas = np.concatenate([theta, [0.8, -0.5, 0.1, 2.0, 0.05]]) + 0.1 * rng.standard_normal((3, plain.size))
    found, meant = ours.predict(thetas), plain.predict(thetas)
    np.testing.assert_allclose(found[:, -T.size :], meant[:, -T.size :], rtol=1e-9, atol=1e-9)  # one sensor
    np.testing.assert_allclose(found, meant, atol=3e-4)  # several sensors share a finer grid here
    np.testing.assert_allclose(ours.predict(thetas[0]), found[0], atol=3e-4)
    for one, other in zip(ours.jacobian(thetas[0]), plain.jacobian(thetas[0]), strict=True):
        np.testing.assert_allclose(one[-T.size :], other[-T.size :], rtol=1e-6, atol=1e-6 * np.max(np.abs(other)))


@pytest.mark.parametrize("name", SYSTEMS)
def test_the_start_is_the_one_that_the_data_were_made_with(name: str) -> None:
    system, p = SYSTEMS[name]
    empty = problem(system, True)
    start = np.array([0.8, -0.5, 0.1, 1.0, 0.05])
    theta = np.concatenate([np.log([p[n] for n in OutputError(empty).free]), start])
    data = OutputError(empty).predict(theta[None])[0]
    records, at = [], 0
    for record in empty.records:
        channels = []
        for channel in record.channels:
            channels.append(replace(channel, values=data[at : at + channel.n]))
            at += channel.n
        records.append(replace(record, channels=tuple(channels)))
    found = compiled_output_error(replace(empty, records=tuple(records))).vector(p)
    np.testing.assert_allclose(found, theta, atol=2e-3)


def test_what_diverges_is_not_finite() -> None:
    system, p = SYSTEMS["Duffing"]
    model = compiled_output_error(problem(system, False))
    logs = np.log([p[n] for n in model.free])
    thetas = np.stack([np.concatenate([logs, own, [0.0, 1.0, 0.0]]) for own in ([0.8, 0.0], [1e9, 0.0])])
    with np.errstate(all="ignore"):
        found = model.predict(thetas)
    assert not np.all(np.isfinite(found[1]))
