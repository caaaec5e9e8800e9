"""Stores of simulated cells, and the sites that the command makes of them."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from html.parser import HTMLParser
from pathlib import Path

import numpy as np

from bench.commands.main import main
from bench.contract.estimate import Status
from bench.information.fisher import Bound
from bench.reporting.frame import Result
from bench.reporting.page.reading import ScenarioPanel, named
from bench.scoring.row import Row
from bench.scoring.summary import summarise
from bench.store.store import Store
from bench.store.stored_cell import StoredCell

BOUND = Bound(
    ("m", "c", "k"),
    {"m": 0.02, "c": 0.04, "k": 0.02, "k_over_m": 0.005, "c_over_m": 0.035},
    {"m": False, "c": False, "k": False, "k_over_m": True, "c_over_m": True},
    {"m": 0.999, "c": 0.25, "k": 0.95, "k_over_m": 0.001, "c_over_m": 0.001},
    0.0107,
    0.006,
    (),
)
SIZES = {"k_over_m_error_pct": 0.5, "c_over_m_error_pct": 3.5, "rmse": 0.01, "m_error_pct": 2.0}


def stored(
    label: str, worse: float = 1.0, *, failed: int = 0, n: int = 40, system: str = "sdof", snr: float = 20.0,
    told: str = "unknown", message: str = "", status: Status = Status.DIVERGED, gross: int = 0, duration: float = 10.0,
) -> StoredCell:  # fmt: skip
    """A cell whose errors are half-normal of the bound's size times ``worse``; the same draws for every method.

    The first ``failed`` fits fail; of the last ``gross`` the error of k/m is 20 times the bound.
    """
    draws = np.abs(np.random.default_rng(1).standard_normal((n, len(SIZES))))
    draws[n - gross :, 0] = 20.0 / worse  # none where gross is 0
    draws *= np.random.default_rng(len(label)).uniform(0.999, 1.001, (n, 1))
    rows = [
        Row(i, status, message)
        if i < failed
        else Row(
            i, Status.OK, scores={m: worse * size * draws[i, j] for j, (m, size) in enumerate(SIZES.items())},
            cpu_s=0.01 * worse,
        )
        for i in range(n)
    ]  # fmt: skip
    data = {
        "system": "sdof", "options": {}, "parameters": {"m": 1.0, "c": 0.4, "k": 8.0}, "initial": [[1.0], [0.0]],
        "snr_db": snr, "duration": duration, "samples": 25, "force": None,
    }  # fmt: skip
    prior = {"mass": 0.02, "damping": 1.0, "stiffness": 0.5, "other": 0.5, "wrong": False}
    what = {
        "method": label, "label": label, "settings": {}, "seed": 0, "data": data, "system": system, "snr_db": snr,
        "initial_state": told, "told": {"initial_state": told, "prior": prior}, "sigma": [0.0375],
    }  # fmt: skip
    identity = hashlib.sha256(repr((label, system, snr, told, duration)).encode()).hexdigest()[:20]
    origin = {"commit": "c" * 40, "packages": {"numpy": "2"}, "started": "2026-01-01T00:00:00+00:00"}
    summary = summarise(rows, BOUND)
    return StoredCell(identity, what, tuple(rows), summary, BOUND.prior_share, BOUND.identifiable, 1.0, origin)


def panels_of(*scenarios: Iterable[StoredCell]) -> list[ScenarioPanel]:
    """Scenarios that no experiment describes."""
    return named([ScenarioPanel(tuple(map(Result.of_stored, cells))) for cells in scenarios])


def filled(folder: Path, *cells: StoredCell) -> Store:
    """A store of the given cells."""
    store = Store(folder / "rows")
    store.prepare()
    for cell in cells:
        store.save(cell)
    return store


def made(store: Store) -> Path:
    """The site of a store, by the command: its folder."""
    out = store.folder.parent / "site"
    assert main(["report", f"store={store.folder}", f"results={store.folder.parent}", f"out={out}"]) == 0
    return out


class Page(HTMLParser):
    """What a browser would find: elements with their attributes, and the text outside of style and script."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self._in = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        self._in = tag
        self.text += " " * (tag in ("li", "td", "th", "tr"))

    def handle_data(self, data: str) -> None:
        if self._in not in ("style", "script"):
            self.text += data

    def handle_endtag(self, tag: str) -> None:
        self._in = ""


def text_of(path: Path) -> str:
    """The text of a page with single blanks."""
    return " ".join(Page(path.read_text(encoding="utf-8")).text.split())
