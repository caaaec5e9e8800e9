"""The live twin: lines in, JSON out, state, back-pressure, the page; with a tracker that compiles nothing."""

import http.client
import io
import json
import re
import signal
import socket
import subprocess
import sys
import time
from contextlib import redirect_stderr, redirect_stdout, suppress
from itertools import pairwise
from urllib.error import HTTPError
from urllib.request import urlopen

import numpy as np
import pytest
from conftest import REPOSITORY
from scipy.signal import decimate, lsim

from bench import InputError, Layout, Sample, Sensor
from bench.commands.main import main
from bench.entrants.online import make_online
from bench.records.dominant_frequency import dominant_frequency
from bench.records.reading.table import ReadOptions
from bench.systems import make_system
from bench.twin.filtering import Filter, survey
from bench.twin.lines import Form, form_of, head_of, lines_of
from bench.twin.pressure import Intake
from bench.twin.state import plain, read, restored, resume, save

LAYOUT = Layout(make_system("sdof", {}), (Sensor(),), 0.05, forced=(0,))
RECORD = "\n".join(
    f"{0.05 * i:.3f},{np.sin(0.3 * i) * np.exp(-0.003 * i) + 0.01 * np.cos(77.0 * i):.6f},{np.cos(0.21 * i):.6f}"
    for i in range(400)
)
RLS = ["method=rls", "forced=0"]


@pytest.mark.parametrize(
    ("head", "text", "values"),
    [
        ("0,1,2\n", "0.1,2,3\n", (0.1, 2.0, 3.0)),
        ("t\tx\tf\n0\t1\t2\n", "0.1\t2\t3", (0.1, 2.0, 3.0)),
        ("0 1 2\n", "1e-3 -2 4", (0.001, -2.0, 4.0)),
        ("0,1,2\n", "0.5,,2", (0.5, np.nan, 2.0)),  # an empty field is a missing value
        ("# a comment\nt;x;f\n0;1,5;2,5\n", "0,5; NaN; 2", (0.5, np.nan, 2.0)),
        ("f (kN), t (ms), x1 (mm)\n0,1,2\n", "3,20,5\n", (0.02, 0.005, 3000.0)),  # names and units as in files
        ("0,1,2\n", "0.5,1", None),
        ("0,1,2\n", "t,x,f", None),
        ("0,1,2\n", "# 1,2", None),
        ("0,1,2\n", "", None),
    ],
)
def test_the_sample_of_a_line(head, text, values) -> None:
    sample = form(head).sample(text)
    if values is None:
        assert sample is None
    else:
        np.testing.assert_array_equal([sample.time, *sample.values, *sample.forces], values)


def form(head: str, roles: tuple[str, ...] = ("t", "x1", "f1"), **options) -> Form:
    return form_of(*head_of(iter(head.splitlines(keepends=True)), 3), roles, ReadOptions(**options))


def test_columns_of_a_stream_are_those_of_files() -> None:
    raw = "test0.txt\nRate - 5000\nLow G\tAccel\tPin\tTime\nVolt\tVolt\tVolt\tSec\n0.0 0.0 0\t\t0.0 0.0 0\t\n\n"
    read = form(raw + "0.5\t6\t1\t0\n0.25\t7\t1\t2E-4\n", ("t", "a1"), columns={"t": 3, "a": "Low G"})
    assert read.sample("0.125\t7\t1\t4E-4\n").values == (0.125,)
    assert (read.fields, read.sizes) == ((3, 0), (1.0, 1.0))
    assert form("0,1,2\n", units={"x": "mm"}).sizes == (1.0, 1e-3, 1.0)
    for head, options, said in (
        ("t,x,f\n0,1,2\n", {"columns": {"t": 0, "x": 1}}, "columns=f1: missing; add f1:<number>"),
        ("t,y (m/s),f\n0,1,2\n", {}, "measures velocity, not displacement"),
        ("0,1,2,3\n", {}, "its column is ambiguous among columns 0 to 3"),
        ("0,1,2\n", {"units": {"v": "mm/s"}}, "no column has the role v"),
        ("one\ntwo\n", {}, "no line of the form t, x1, f1"),
    ):
        with pytest.raises(InputError, match=re.escape(said)):
            form(head, **options)


def test_a_file_that_grows_is_followed_half_lines_included(tmp_path) -> None:
    place = tmp_path / "stream.csv"
    place.write_text("0,1\n0.1,")
    with place.open() as source:
        found = lines_of(source, follow=True)
        assert next(found) == "0,1\n"
        with place.open("a") as writer:
            writer.write("2\n")
        assert next(found) == "0.1,2\n"
        found.close()


def run(arguments: list[str], text: str) -> subprocess.CompletedProcess:
    """Run the command on a stream, in this process."""
    out, err = io.StringIO(), io.StringIO()
    streams = redirect_stdout(out), redirect_stderr(err)
    with pytest.MonkeyPatch.context() as patch, streams[0], streams[1]:
        patch.setattr(sys, "stdin", io.StringIO(text))
        status = main(["track", *arguments])
    return subprocess.CompletedProcess(arguments, status, out.getvalue(), err.getvalue())


def test_a_line_of_json_comes_out_for_each_sample() -> None:
    done = run(RLS, "t,x,f\n" + RECORD + "\nnonsense\n")
    assert done.returncode == 0, done.stderr
    found = [json.loads(line) for line in done.stdout.splitlines()]
    assert [one["sample"] for one in found] == list(range(1, 401))
    assert found[-1]["t"] == pytest.approx(0.05 * 399)
    assert "not of the form t, x1, f1" in done.stderr
    for one in found[-1]["quantities"].values():
        assert one["low"] < one["value"] < one["high"]


@pytest.mark.parametrize("field", ["out", "state"])
@pytest.mark.parametrize("alias", ["{0}/log.csv", "{0}/link.csv", "{0}/more/../log.csv"])
def test_a_recording_is_not_overwritten(field, alias, tmp_path, capsys) -> None:
    log = tmp_path / "log.csv"
    log.write_text(RECORD)
    (tmp_path / "more").mkdir()
    (tmp_path / "link.csv").symlink_to(log)
    assert main(["track", *RLS, f"from={log}", f"{field}={alias.format(tmp_path)}"]) == 2
    assert "from= names the same file" in capsys.readouterr().err
    assert main(["track", *RLS, f"from={log}", f"out={tmp_path}/new", f"state={tmp_path}/more/../new"]) == 2
    assert "out= names the same file" in capsys.readouterr().err
    assert log.read_text() == RECORD
    assert not (tmp_path / "new").exists()


def test_a_time_from_far_away_is_left_out_until_another_follows() -> None:
    rows = RECORD.splitlines()
    text = "\n".join(
        [*rows[:100], "1e308,0,0", "1e18,0,0", *rows[100:200], *(f"{1e6 + 0.05 * i},1,0" for i in range(3))]
    )
    for more, delay in ([], 0), (["band=0.1:8"], 1):  # a sample for the force
        found = [json.loads(line) for line in run([*RLS, "rate=20", *more], text).stdout.splitlines()]
        far = [i for i, one in enumerate(found) if "far after the previous one" in one["message"]]
        assert far == [100 - delay, 101 - delay, 202 - delay]
        assert [found[i]["t"] for i in far] == [1e308, 1e18, 1e6]
        assert [one["sample"] for one in found if one["t"] < 10] == list(range(1, 201 - delay))
        assert found[-1]["sample"] == 202 - 2 * delay


def test_a_fast_record_is_decimated_and_the_user_told() -> None:
    rng = np.random.default_rng(3)
    times = np.arange(8000) / 5000
    x = np.exp(-1.5 * times) * np.sin(2 * np.pi * 28 * times) + 0.01 * rng.standard_normal(8000)
    done = run(["method=rls"], "\n".join(f"{t:.4f},{y:.6f}" for t, y in zip(times, x, strict=True)))
    assert "sampling rate 5,000 1/s, decimate=17 leaves 294.1; strongest: 28" in done.stderr
    found = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(found) == 8000 // 17
    at, measured = np.array([one["t"] for one in found]), np.array([one["measured"][0] for one in found])
    assert dominant_frequency(at, measured) == pytest.approx(28, rel=0.01)
    assert np.max(np.abs(measured)) == pytest.approx(1.0, abs=0.05)


def test_a_line_that_is_stronger_than_the_motion_is_named_and_a_band_leaves_it_out() -> None:
    times = np.arange(2500) / 5000
    x = np.exp(-2 * times) * np.sin(2 * np.pi * 26 * times) + 3 * np.sin(2 * np.pi * 2000.1 * times)
    samples = [Sample(t, (y,)) for t, y in zip(times, x, strict=True)]
    decimation, text = survey(samples, 2e-4, None, None)
    assert decimation == 1
    assert "strongest: 2000 Hz, then 26" in text
    assert "2000 Hz may be the mains: if it is not the motion, give band=lo:hi" in text
    decimation, text = survey(samples, 2e-4, (10.0, 60.0), None)
    assert decimation == 19
    assert "strongest in band=10:60: 26" in text
    assert survey(samples, 2e-4, None, 7)[0] == 7
    assert survey([Sample(t, (1.0,)) for t in times], 2e-4, None, None)[0] <= 250  # a sensor that does not move yet
    assert survey(samples[:20], 0.05, None, None) == (1, "sampling rate 20 1/s, decimate=1")


def test_a_clipped_sensor_is_noticed_before_the_filter_smooths_it() -> None:
    filtered = Filter(0.001, 10, sensors=(Sensor(),))
    values = np.clip(np.sin(2 * np.pi * np.arange(4000) / 400 + 0.1), -0.8, 0.8)
    got = [s.values[0] for i, y in enumerate(values) if (s := filtered.take(Sample(0.001 * i, (y,))))]
    missing = np.isnan(got)
    clipped = np.abs(values[9::10]) == 0.8
    assert np.mean(missing[40:] == clipped[40:]) > 0.9


def test_decimation_is_that_of_scipy_and_a_force_is_not_delayed_against_the_motion() -> None:
    n, step, slow = 20_000, 1e-3, 20
    times = step * np.arange(n)
    force = np.sin(3.0 * times) + np.sin(7.0 * times)
    _, motion, _ = lsim(([1.0], [2.0, 0.5, 40.0]), force, times, interp=False)
    rows = np.column_stack([motion, force])
    filtered = Filter(step, slow, sensors=(Sensor(),))
    got = [s for t, row in zip(times, rows, strict=True) if (s := filtered.take(Sample(t, (row[0],), (row[1],))))]
    np.testing.assert_allclose(
        [s.values[0] for s in got[50:]], decimate(motion[slow - 1 :], slow, 7, zero_phase=False)[50:-1], atol=2e-4
    )
    again, held = [got[0].values[0]], np.array([s.forces[0] for s in got])
    at = slow * step * np.arange(len(got))
    _, again, _ = lsim(([1.0], [2.0, 0.5, 40.0]), held, at, interp=False)
    half = len(got) // 2  # the start is forgotten by then
    error = again[half:] - np.array([s.values[0] for s in got[half:]])
    assert np.std(error) < 0.01 * np.std(again[half:])


def test_a_filter_fills_a_short_gap_and_says_what_is_missing() -> None:
    filtered = Filter(0.01, 4, sensors=(Sensor(limits=(-1.0, 1.0)),))
    times = [0.01 * i for i in range(40) if not 8 <= i < 12] + [5.0 + 0.01 * i for i in range(8)]
    values = [5.0 if 15 < t / 0.01 < 20 else 0.5 - 1e-9 * (i % 7) for i, t in enumerate(times)]
    got = [s for t, y in zip(times, values, strict=True) if (s := filtered.take(Sample(t, (y,))))]
    np.testing.assert_allclose([s.values[0] for s in got if np.isfinite(s.values[0])], 0.5, rtol=1e-6)
    assert sum(np.isnan(s.values[0]) for s in got) >= 1
    assert all(a.time < b.time for a, b in pairwise(got))
    assert filtered.take(Sample(5.07, (0.5,))) is None  # seen before
    with pytest.raises(InputError, match="below half the sampling rate"):
        Filter(0.01, band=(10.0, 60.0))


def test_a_line_of_ten_million_letters_is_left_out() -> None:
    rows = RECORD.splitlines()
    done = run(RLS, "\n".join([*rows[:100], "1" * 10_000_000, *rows[100:]]))
    assert done.returncode == 0, done.stderr
    assert "1 line(s) ignored, not of the form t, x1, f1: '1111" in done.stderr
    assert json.loads(done.stdout.splitlines()[-1])["sample"] == len(rows)


def test_the_state_is_numbers_and_comes_back_whole(tmp_path) -> None:
    value = {"a": np.array([[1.0, np.nan], [np.inf, -2.5]]), "b": [1, 2.5], "c": None, "d": "x"}
    again = {key: restored(one) for key, one in json.loads(json.dumps({k: plain(v) for k, v in value.items()})).items()}
    assert np.array_equal(again["a"], value["a"], equal_nan=True)
    assert {key: again[key] for key in "bcd"} == {key: value[key] for key in "bcd"}
    method, place = make_online("rls"), tmp_path / "state.json"
    tracker = method.start(LAYOUT)
    tracker.update(Sample(0.0, (1.0,), (0.5,)))
    save(place, method, tracker, Filter(0.05))
    assert resume(place, read(place), method, LAYOUT, Filter(0.05)).samples == 1
    for other, filtered in (({"factor": 0.9}, Filter(0.05)), ({}, Filter(0.05, band=(1.0, 2.0)))):
        with pytest.raises(InputError, match="another method"):
            resume(place, read(place), make_online("rls", other), LAYOUT, filtered)
    place.write_text("{}")
    with pytest.raises(InputError, match="not a state file"):
        read(place)


@pytest.mark.parametrize("more", [[], ["decimate=2", "band=0.1:8"]])
def test_a_killed_run_goes_on_and_counts_nothing_twice(more, tmp_path) -> None:
    out, state = tmp_path / "o.jsonl", tmp_path / "s.json"
    given = [*RLS, *more, f"out={out}", f"state={state}", "save_every=50", "rate=20"]
    whole, n = run([*RLS, *more, "rate=20"], RECORD), 84 if more else 170
    killed = subprocess.Popen([sys.executable, "-m", "bench", "track", *given], stdin=subprocess.PIPE, text=True,
                              cwd=REPOSITORY)  # fmt: skip
    killed.stdin.write("\n".join(RECORD.splitlines()[:170]) + "\n")
    killed.stdin.flush()
    until = time.monotonic() + 60
    while not (out.is_file() and len(out.read_text().splitlines()) >= n) and time.monotonic() < until:
        time.sleep(0.05)
    killed.send_signal(signal.SIGKILL)
    killed.wait()
    killed.stdin.close()
    assert read(state)["samples"] == n // 50 * 50
    again = run([*given, "resume=true"], RECORD)
    assert again.returncode == 0, again.stderr
    assert f"{102 if more else 150} sample(s) used before are ignored" in again.stderr
    one, other = ([json.loads(line) for line in text.splitlines()] for text in (whole.stdout, out.read_text()))
    for each in (*one, *other):
        each.pop("waiting")
    assert one == other


def test_lag_keeps_every_sample_and_says_so(caplog) -> None:
    intake = Intake((f"{i},1,0\n" for i in range(100)), form("0,1,0\n"), "lag", 20)
    time.sleep(0.2)
    found = []
    while (sample := intake.get()) is not None:
        found.append(sample.time)
    assert found == list(range(100))
    assert "all are used" in caplog.text


def test_decimation_leaves_out_what_it_counts_and_says_so(caplog) -> None:
    intake, found = Intake((f"{i},1,0\n" for i in range(300)), form("0,1,0\n"), "decimate", 20), []
    while (sample := intake.get()) is not None:
        found.append(sample.time)
        time.sleep(0.001)
    assert len(found) + intake.decimated == 300
    assert intake.decimated > 0
    assert "one in 2 is used" in caplog.text


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


@pytest.mark.slow
def test_the_page_answers_this_machine_alone_and_survives_what_is_no_request(page, capfd) -> None:
    address = ("127.0.0.1", page._server.server_port)
    ours = f"localhost:{address[1]}"

    def status(host: str, origin: dict[str, str]) -> int:
        connection = http.client.HTTPConnection(*address, timeout=10)
        connection.request("GET", "/", headers={"Host": host, **origin})
        return connection.getresponse().status

    asked = [
        (ours, {}),
        (f"[::1]:{address[1]}", {"Origin": f"http://{ours}"}),
        ("elsewhere.org:80", {}),
        ("localhost", {}),
    ]
    assert [status(*each) for each in asked] == [200, 200, 403, 403]
    assert status(ours, {"Origin": "http://elsewhere.org"}) == 403
    odd = [
        b"GET / HTTP/9.\xb2\r\n\r\n",
        b"GET / HTTP/1.x\r\n\r\n",
        b"\0\xff" * 99 + b"\r\n\r\n",
        b"GET",
        b"POST / HTTP/1.1\r\n\r\n",
        b"GET / HTTP/1.1\r\nX: " + b"y" * 200_000 + b"\r\n\r\n",
        b"GET / HTTP/1.1\r\n" + b"a: b\r\n" * 2000,
    ]
    sockets = [socket.create_connection(address, timeout=10) for _ in range(100)]
    for connection in sockets:
        connection.close()
    for text in odd:
        with socket.create_connection(address, timeout=10) as connection, suppress(OSError):
            connection.sendall(text)
            connection.shutdown(socket.SHUT_WR)
            while connection.recv(65_536):
                pass
    page.add(answer(1))
    assert status(ours, {}) == 200
    assert capfd.readouterr().err == ""


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
