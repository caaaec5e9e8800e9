"""One measurement in a process of its own: a script, run by the code of whichever checkout ``PYTHONPATH`` names.

It uses only names that earlier checkouts have, too. Its argument is the task as JSON; it prints a line at each new
beginning, and the answer as one line of JSON. Its starter has fixed the number of threads to one.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import importlib
import json
import resource
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

METHOD_STREAM = 5
"""Key of the random streams of the fits; both checkouts get the same."""
IMPORTED = ("bench", "jax", "jaxlib", "numpy", "scipy")
"""Packages whose modules a process can be told to import beforehand."""
NO_MEMORY = 3
"""Exit status of a measurement that needs more memory than it may have."""


def begin() -> None:
    """Tell the starter that its limit of processor time counts from here on.

    It is the starter that keeps it: with a limit of the kernel's own the clock would go by ticks of milliseconds.
    """
    print("begin", flush=True)


def limit_memory(megabytes: float) -> None:
    """Let an allocation beyond a limit of the address space fail."""
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (int(megabytes * 2**20), hard))


def scenario_of(task: dict[str, Any], scale: float = 1.0) -> Any:
    """The scenario of a task; ``scale`` multiplies its parameters, which makes another of the same kind."""
    from bench.config.experiment import expand

    found = expand(task["overrides"], multirun=False)[0].scenario
    fields = dict(task["fields"])
    if "initial" in fields:
        fields["initial"] = tuple(map(tuple, fields["initial"]))
    parameters = {name: scale * value for name, value in fields.get("parameters", found.parameters).items()}
    return dataclasses.replace(found, **{**fields, "parameters": parameters})


def answer_of(estimate: Any) -> dict[str, Any]:
    """Status, the logarithms of what is estimated and their standard errors, and how many responses that took."""
    said = {"status": str(estimate.status), "message": estimate.message, "evaluations": estimate.cost.evaluations}
    distribution = estimate.distribution
    if distribution is None:
        return {**said, "values": {}, "errors": {}}
    values = np.array(list(distribution.values().values()))
    if hasattr(distribution, "samples"):
        errors = np.std(np.log(distribution.samples), axis=0)
    elif distribution.covariance is None:
        errors = np.full(values.size, np.nan)
    else:
        errors = np.sqrt(np.diag(distribution.covariance)) / (1.0 if distribution.log else np.abs(values))
    names = list(distribution.names)
    return {
        **said,
        "values": dict(zip(names, map(float, np.log(np.abs(values))), strict=True)),
        "errors": dict(zip(names, map(float, errors), strict=True)),
    }


def digest(problems: Sequence[Any]) -> str:
    """A hash of the samples and of the nominal values, by which two checkouts see that they fitted the same."""
    content = hashlib.sha256()
    for problem in problems:
        for record in problem.records:
            for channel in record.channels:
                content.update(np.ascontiguousarray(channel.values).tobytes())
        content.update(json.dumps(problem.prior.nominal if problem.prior else {}, sort_keys=True).encode())
    return content.hexdigest()[:12]


def repeated(step: Callable[[int], Any], task: dict[str, Any]) -> tuple[list[float], Any]:
    """Processor seconds of a step, over and over until its time is spent; and what its first run gave."""
    seconds, first = list[float](), None
    while len(seconds) < task["repeats"] and sum(seconds) <= task["budget_s"]:
        begin()
        started = time.process_time()
        found = step(len(seconds))
        seconds.append(time.process_time() - started)
        first = found if first is None else first
    return seconds, first


def fit(task: dict[str, Any]) -> dict[str, Any]:
    """Fits of data sets together; before these, two of one mass that do not count, since they import what is needed."""
    from bench.config.experiment import expand
    from bench.entrants.registry import default_settings, make_method

    method = make_method(task["method"], default_settings(task["method"]))

    def problems(scenario: Any, n: int) -> list[Any]:
        make = scenario.maker(task["seed"])
        return [make(i)[0] for i in range(n)]

    def streams(n: int) -> list[Any]:
        return [np.random.default_rng([METHOD_STREAM, task["seed"], i]) for i in range(n)]

    begin()
    easy = expand(["method=prior", "system=sdof"], multirun=False)[0].scenario
    method.identify_many(problems(easy, 2), streams(2))
    scenario, n = scenario_of(task), task["together"]
    sets = [problems(scenario, n) for _ in range(task["repeats"])]  # nothing kept with a problem helps the next
    seconds, found = repeated(lambda i: method.identify_many(sets[i], streams(n)), task)
    return {
        "seconds": [one / n for one in seconds],
        "answers": [answer_of(estimate) for estimate in found],
        "data": digest(sets[0]),
        "peak_mb": peak_mb(),
    }


def bound(task: dict[str, Any]) -> dict[str, Any]:
    """Bounds of scenarios that are new to this process.

    With ``warm`` one of another scenario is computed before. Without it, the ``modules`` that an earlier process ended
    with are imported before the clock runs, since many are imported only when they are needed.
    """
    for name in task["modules"]:
        with contextlib.suppress(Exception):
            importlib.import_module(name)
    from bench.information.fisher import compute_bound

    begin()
    if task["warm"]:
        compute_bound(scenario_of(task, 1.5), task["seed"])
    seconds, found = repeated(lambda i: compute_bound(scenario_of(task, 1.0 + 0.01 * i), task["seed"]), task)
    told = {name: sd for name, sd in found.relative_sd.items() if np.isfinite(sd) and sd > 0}
    values = {**told, "rmse": found.rmse, "rmse_forecast": found.rmse_forecast}
    answer = {
        "status": "ok",
        "message": "",
        "evaluations": 1,
        "values": {name: float(np.log(value)) for name, value in values.items()},
        "errors": dict.fromkeys(values, 1.0),
    }
    return {
        "seconds": seconds,
        "answers": [answer],
        "data": "",
        "peak_mb": peak_mb(),
        "modules": [name for name in sys.modules if name.partition(".")[0] in IMPORTED],
    }


def peak_mb() -> float:
    """The most memory that this process has held so far (Linux: what getrusage says counts its starter's, too)."""
    with open("/proc/self/status", encoding="ascii") as lines:
        return next(int(line.split()[1]) / 2**10 for line in lines if line.startswith("VmHWM"))


def answer(run: Callable[[dict[str, Any]], dict[str, Any]]) -> int:
    """Do what the argument says, as JSON in and out; exit status 3 where the memory does not suffice."""
    task = json.loads(sys.argv[1])
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    limit_memory(task["memory_mb"])
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            found = run(task)
    except MemoryError:
        return NO_MEMORY
    print(json.dumps(found))
    return 0


if __name__ == "__main__":
    sys.exit(answer(lambda task: {"fit": fit, "bound": bound}[task["kind"]](task)))
