"""The live twin: lines in, JSON out, state, back-pressure, the page; with a tracker that compiles nothing."""

import io
import json
import signal
import subprocess
import sys
import time
from pathlib import Path
from urllib.error import HTTPError
from urllib.request import urlopen

import numpy as np
import pytest
from conftest import REPOSITORY

from bench import InputError, Layout, Sample, Sensor
from bench.commands.main import main
from bench.entrants.online import make_online
from bench.systems import make_system
from bench.twin.lines import Form, lines
from bench.twin.pressure import Intake
from bench.twin.state import plain, read, restored, resumed, save

LAYOUT = Layout(make_system("sdof", {}), (Sensor(),), 0.05, forced=(0,))
RECORD = "\n".join(
    f"{0.05 * i:.3f},{np.sin(0.3 * i) * np.exp(-0.003 * i) + 0.01 * np.cos(77.0 * i):.6f},{np.cos(0.21 * i):.6f}"
    for i in range(400)
)
RLS = ["method=rls", "forced=0"]


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("0.1,2,3\n", (0.1, 2.0, 3.0)),
        ("0.1\t2\t3", (0.1, 2.0, 3.0)),
        ("1e-3 -2 4", (0.001, -2.0, 4.0)),
        ("0.5,,2", (0.5, np.nan, 2.0)),  # an empty field is a missing value
        ("0.5, NaN; 2", (0.5, np.nan, 2.0)),
        ("0.5,1", None),
        ("t,x,f", None),
        ("# 1,2", None),
        ("", None),
    ],
)
def test_the_sample_of_a_line(text, values) -> None:
    sample = Form(1, 1).sample(text)
    if values is None:
        assert sample is None
    else:
        np.testing.assert_array_equal([sample.time, *sample.values, *sample.forces], values)


def test_a_file_that_grows_is_followed_half_lines_included(tmp_path) -> None:
    place = tmp_path / "stream.csv"
    place.write_text("0,1\n0.1,")
    with place.open() as source:
        found = lines(source, str(place), follow=True)
        assert next(found) == "0,1\n"
        with place.open("a") as writer:
            writer.write("2\n")
        assert next(found) == "0.1,2\n"
        found.close()


def run(arguments: list[str], text: str) -> subprocess.CompletedProcess:
    command = [sys.executable, "-m", "bench", "track", *arguments]
    return subprocess.run(command, input=text, capture_output=True, text=True, cwd=REPOSITORY, check=False)


def test_a_line_of_json_comes_out_for_each_sample() -> None:
    done = run(RLS, "t,x,f\n" + RECORD + "\nnonsense\n")
    assert done.returncode == 0, done.stderr
    found = [json.loads(line) for line in done.stdout.splitlines()]
    assert [one["sample"] for one in found] == list(range(1, 401))
    assert found[-1]["t"] == pytest.approx(0.05 * 399)
    assert "do not read t, y1, f1" in done.stderr
    for one in found[-1]["quantities"].values():
        assert one["low"] < one["value"] < one["high"]


def test_a_stream_without_a_readable_line_is_refused() -> None:
    done = run(["method=rls", "forced=0", "rate=20"], "one two\nthree\n")
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].endswith("lines that read t, y1, f1")


def test_what_stood_at_the_end_is_shown_where_there_is_no_terminal() -> None:
    done = run([*RLS, "view=true", "out=none"], RECORD)
    assert done.returncode == 0, done.stderr
    assert "sample 400" in done.stderr
    assert "k/m" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["method=efk"], "did you mean ekf"),
        (["from=nowhere.csv"], "there is no such file"),
        (["resume=true"], "with state=<file>"),
        (["rate=fast", "method=rls"], "rate=fast: input should be a valid number"),
        (["method=rls", "ambient=0"], "the force is not known"),
        (["limits=3", "method=rls"], "lo:hi"),
        (["method=rls", "method.factor=2"], "method.factor"),
    ],
)
def test_what_is_mistyped_is_said_in_a_line_with_status_2(arguments, said, capsys, monkeypatch) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO())
    assert main(["track", *arguments]) == 2
    error = capsys.readouterr().err.strip()
    assert said in error
    assert "\n" not in error


def test_the_state_is_numbers_and_comes_back_whole(tmp_path) -> None:
    value = {"a": np.array([[1.0, np.nan], [np.inf, -2.5]]), "b": [1, 2.5], "c": None, "d": "x"}
    again = {key: restored(one) for key, one in json.loads(json.dumps({k: plain(v) for k, v in value.items()})).items()}
    assert np.array_equal(again["a"], value["a"], equal_nan=True)
    assert {key: again[key] for key in "bcd"} == {key: value[key] for key in "bcd"}
    method, place = make_online("rls"), tmp_path / "state.json"
    tracker = method.start(LAYOUT)
    tracker.update(Sample(0.0, (1.0,), (0.5,)))
    save(place, method, tracker)
    assert resumed(place, read(place), method, LAYOUT).samples == 1
    with pytest.raises(InputError, match="another method"):
        resumed(place, read(place), make_online("rls", {"factor": 0.9}), LAYOUT)
    place.write_text("{}")
    with pytest.raises(InputError, match="not a state file"):
        read(place)


def test_a_killed_run_goes_on_and_counts_nothing_twice(tmp_path) -> None:
    out, state = tmp_path / "o.jsonl", tmp_path / "s.json"
    given = [*RLS, f"out={out}", f"state={state}", "save_every=50", "rate=20"]
    whole = run([*RLS, "rate=20"], RECORD)
    killed = subprocess.Popen([sys.executable, "-m", "bench", "track", *given], stdin=subprocess.PIPE, text=True,
                              cwd=REPOSITORY)  # fmt: skip
    killed.stdin.write("\n".join(RECORD.splitlines()[:170]) + "\n")
    killed.stdin.flush()
    until = time.monotonic() + 60
    while not (out.is_file() and len(out.read_text().splitlines()) >= 170) and time.monotonic() < until:
        time.sleep(0.05)
    killed.send_signal(signal.SIGKILL)
    killed.wait()
    killed.stdin.close()
    assert read(state)["samples"] == 150
    again = run([*given, "resume=true"], RECORD)
    assert again.returncode == 0, again.stderr
    assert "150 sample(s) had been seen before" in again.stderr
    one, other = ([json.loads(line) for line in text.splitlines()] for text in (whole.stdout, out.read_text()))
    for each in (*one, *other):
        each.pop("waiting")
    assert one == other


def test_lag_keeps_every_sample_and_says_so(capsys) -> None:
    intake = Intake((f"{i},1,0\n" for i in range(100)), Form(1, 1), "lag", 20)
    time.sleep(0.2)
    found = []
    while (sample := intake.get()) is not None:
        found.append(sample.time)
    assert found == list(range(100))
    assert "none is left out" in capsys.readouterr().err


def test_decimation_leaves_out_what_it_counts_and_says_so(capsys) -> None:
    intake, found = Intake((f"{i},1,0\n" for i in range(300)), Form(1, 1), "decimate", 20), []
    while (sample := intake.get()) is not None:
        found.append(sample.time)
        time.sleep(0.001)
    assert len(found) + intake.decimated == 300
    assert intake.decimated > 0
    assert "one sample in 2 is taken" in capsys.readouterr().err


@pytest.fixture
def page():
    from bench.twin.page import PageServer

    made = PageServer(LAYOUT, 0)
    yield made
    made.close()


def answer(number: int) -> dict:
    one = {"value": 5.0, "low": 4.0, "high": 6.0, "unit": "1/s²"}
    return {
        "sample": number, "t": 0.01 * number, "status": "ok", "message": "", "quantities": {"k_over_m": one},
        "measured": [np.sin(0.1 * number)], "prediction": [np.sin(0.1 * number)], "prediction_sd": [0.1],
        "residual": [0.0], "alarm": None, "ringing": number == 30, "waiting": 0, "decimated": 0, "unreadable": 0,
    }  # fmt: skip


def test_the_page_is_on_the_loopback_interface_and_may_load_nothing_from_elsewhere(page) -> None:
    assert page.url.startswith("http://127.0.0.1:")
    with urlopen(page.url) as found:
        assert found.headers["Content-Security-Policy"].startswith("default-src 'none'")
        text = found.read().decode()
    assert "//" not in text.replace("</", "")
    with pytest.raises(HTTPError, match="404"):
        urlopen(page.url + "secrets")


def test_a_page_opened_late_is_sent_what_is_kept(page) -> None:
    for number in range(1, 2101):
        page.add(answer(number))
    with urlopen(page.url + "events") as stream:
        found = []
        while not found:
            line = stream.readline().decode()
            if line.startswith("data: ["):
                found = json.loads(line.removeprefix("data: "))
    assert [found[0]["sample"], found[-1]["sample"]] == [101, 2100]


def test_the_page_follows_in_a_browser_without_a_word_on_the_console(page, tmp_path) -> None:
    webdriver = pytest.importorskip("selenium.webdriver")
    options = webdriver.ChromeOptions()
    for argument in ("--headless=new", "--no-sandbox", "--window-size=1300,1000", f"--user-data-dir={tmp_path}"):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    try:
        browser = webdriver.Chrome(options=options)
    except Exception as error:
        pytest.skip(f"no browser: {error}")
    try:
        browser.get(page.url)
        for number in range(1, 61):
            page.add(answer(number))
            time.sleep(0.005)
        added = time.monotonic()
        while browser.execute_script("return document.querySelector('#standing').dataset.sample") != "60":
            assert time.monotonic() - added < 10
        assert "alarm" in browser.execute_script("return document.querySelector('#log').textContent")
        assert (
            browser.execute_script("return document.querySelector('#values').textContent").count("4.000 to 6.000") == 1
        )
        assert browser.get_log("browser") == []
        sent = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
        urls = [one["params"]["request"]["url"] for one in sent if one["method"] == "Network.requestWillBeSent"]
        assert urls
        assert [url for url in urls if not url.startswith((page.url, "data:", "chrome"))] == []
    finally:
        browser.quit()


def test_what_the_page_needs_travels_with_the_package() -> None:
    assets = Path(REPOSITORY) / "bench" / "twin" / "assets"
    assert {"page.html", "page.js", "page.css", "uplot.js", "uplot.css", "uplot-LICENSE.txt"} <= {
        p.name for p in assets.iterdir()
    }
