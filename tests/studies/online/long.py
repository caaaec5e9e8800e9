"""A long record: what a tracker holds, and the time of a sample."""

from __future__ import annotations

import dataclasses
import resource
import time

import numpy as np
from rich.console import Console
from rich.progress import track

from bench.config.online import online_scenario
from bench.entrants.online import make_online, online_card
from bench.online.follow import held_bytes
from bench.reporting.tables.render import markdown_table

SAMPLES, EARLY = 100_000, 2_000
METHODS = ("ekf", "imm", "change_points", "cusum", "rls", "ar")


def long_record(samples: int = SAMPLES) -> str:
    """A row a method."""
    scenario = dataclasses.replace(online_scenario("constant_multisine"), samples=samples)
    stream = scenario.stream(3, 0)
    rows = []
    for name in METHODS:
        tracker = make_online(name).start(stream.layout)
        tracker.prepare()
        micros, before, grown = np.empty(samples), 0, 0
        for i, sample in enumerate(track(stream.samples(), name, console=Console(stderr=True))):
            started = time.perf_counter()
            tracker.update(sample)
            micros[i] = 1e6 * (time.perf_counter() - started)
            if i == EARLY:
                before, grown = held_bytes(tracker), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - grown
        late = micros[EARLY:]
        rows.append([
            online_card(name).title, f"{before / 1000:.2f}", f"{held_bytes(tracker) / 1000:.2f}", f"{grown / 1000:.1f}",
            f"{np.median(late):.0f}", f"{np.quantile(late, 0.99):.0f}", f"{late.max():.0f}",
        ])  # fmt: skip
    headers = ["method", f"kB held after {EARLY:,} samples", f"after {samples:,}", "MB grown between",
               "µs a sample, median", "99 %", "largest"]  # fmt: skip
    return f"{HEAD}\n\n{markdown_table(rows, headers)}"


HEAD = """## A long record

One degree of freedom under a known force, on the machine that made this page, one process alone."""
