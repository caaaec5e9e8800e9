"""A live run: a script feeds the twin 200 samples a second, and headless Chromium shows its page."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import IO, Any

import numpy as np

from bench.config.online import online_scenario
from bench.errors import InputError
from bench.online.course import Course
from bench.online.scenario import Stream
from bench.reporting.tables.render import markdown_table

RATE = 200
LOOK_S = 0.02


def live(seconds: int, folder: Path) -> str:
    """Feed, look, and tell how far the page was behind; raises InputError without a browser."""
    scenario = replace(
        online_scenario("step10_multisine"), rate=float(RATE), samples=max(RATE * seconds, 400),
        parameters={"m": 1.7, "c": 5.0, "k": 6000.0},
        forces=(replace(online_scenario("step10_multisine").forces[0], low_hz=2.0, high_hz=20.0),),
        varying={"k": Course("step", change=-0.1)},
    )  # fmt: skip
    stream = scenario.stream(4, 0)
    given = ["system=sdof", "forced=0", f"rate={RATE}", "page=true", "out=none", "alarm=1", "method=change_points"]
    twin = subprocess.Popen(
        [sys.executable, "-m", "bench", "track", *given], stdin=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert twin.stdin is not None
    assert twin.stderr is not None
    url = next(line for line in twin.stderr if "http" in line).rpartition(" ")[2].strip()
    said: list[str] = []
    threading.Thread(target=lambda: said.extend(twin.stderr or []), daemon=True).start()
    try:
        with _browser(folder) as browser:
            browser.get(url)
            lags = _watched(browser, stream, twin.stdin)
            browser.save_screenshot(str(folder / "live.png"))
            console = browser.get_log("browser")
            outside = [one for one in _requests(browser) if not one.startswith((url, "data:", "chrome"))]
    finally:
        twin.stdin.close()
        twin.wait(30)
    row = [f"{seconds}", f"{RATE}", f"{np.median(lags):.2f}", f"{np.max(lags):.2f}", f"{len(console)}",
           f"{len(outside)}", f"{len(said)}"]  # fmt: skip
    headers = ["seconds", "samples a second", "page behind, median s", "largest s", "console messages",
               "requests elsewhere", "lines of warning"]  # fmt: skip
    return f"{HEAD}\n\n{markdown_table([row], headers)}"


HEAD = """## A live run

A script writes samples to `python -m bench track method=change_points page=true`, and headless Chromium shows the page.
**behind**: from the moment a sample is written until the page says that it is there."""


def _watched(browser: Any, stream: Stream, pipe: IO[str]) -> np.ndarray:
    """Measure how far the page is behind (s), look by look, while the samples are written."""
    written: list[float] = []

    def feed() -> None:
        begun = time.monotonic()
        for i, sample in enumerate(stream.samples()):
            time.sleep(max(0.0, begun + i / RATE - time.monotonic()))
            pipe.write(",".join(f"{value:.9g}" for value in (sample.time, *sample.values, *sample.forces)) + "\n")
            pipe.flush()
            written.append(time.monotonic())

    feeder = threading.Thread(target=feed)
    feeder.start()
    lags, total = [], len(stream.times)
    shown, until = 0, time.monotonic() + total / RATE + 20.0
    while shown < total and time.monotonic() < until:
        text = browser.execute_script("return document.querySelector('#standing').dataset.sample || '0'")
        now, shown = time.monotonic(), int(text)
        if len(written) > shown:
            lags.append(now - written[shown])  # the oldest that is not there yet
        time.sleep(LOOK_S)
    feeder.join()
    return np.array(lags or [0.0])


def _requests(browser: Any) -> list[str]:
    sent = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    return [one["params"]["request"]["url"] for one in sent if one["method"] == "Network.requestWillBeSent"]


def _browser(folder: Path) -> Any:
    """Start headless Chromium with its logs; raises InputError where there is none."""
    try:
        from selenium import webdriver
    except ImportError:
        raise InputError("part", "live", "needs selenium: pip install 'vibration-bench[browser]'") from None
    options = webdriver.ChromeOptions()
    quiet = ("--disable-background-networking", "--disable-component-update", "--no-first-run", "--disable-sync")
    for argument in ("--headless=new", "--no-sandbox", "--window-size=1300,1500", *quiet):
        options.add_argument(argument)
    options.add_argument(f"--user-data-dir={(folder / 'browser').absolute()}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    os.environ.setdefault("SE_OFFLINE", "true")  # the driver that is installed, without asking anybody
    os.environ.setdefault("SE_AVOID_STATS", "true")
    try:
        return webdriver.Chrome(options=options)
    except Exception as error:
        raise InputError("part", "live", f"no Chromium with its driver ({type(error).__name__})") from None
