"""The files that malformed input names: records, scenarios, submissions; each is made where a test first asks."""

from __future__ import annotations

import base64
import io
import json
import os
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
from stored import resealed

DECAY = [(0.1 * i, np.exp(-0.1 * i) * np.cos(2.0 * i)) for i in range(60)]
GOOD = "t (s),x (m)\n" + "".join(f"{t:.1f},{x:.6f}\n" for t, x in DECAY)
SDOF = """label: own
kind: sdof
options: {}
parameters: {m: 1.0, c: 0.4, k: 8.0}
initial: {displacement: [1.0], velocity: [0.0]}
duration: 10.0
samples: 25
force: null
"""
IDENTITY = "0123456789abcdef0123"


def rows(change: Callable[[int, float, float], str]) -> bytes:
    """Return the good record with each of its rows changed."""
    return "\n".join(["t (s),x (m)", *(change(i, t, x) for i, (t, x) in enumerate(DECAY)), ""]).encode()


def npy(array: np.ndarray) -> bytes:
    """Return an array as a file."""
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def mat() -> bytes:
    """Return a MATLAB file with a record."""
    from scipy.io import savemat

    file = io.BytesIO()
    savemat(file, {"t": np.arange(60.0), "x": np.arange(60.0)}, do_compression=True)
    return file.getvalue()


def parquet(columns: dict[str, list[object]]) -> bytes:
    """Return a Parquet file of columns."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    sink = io.BytesIO()
    pq.write_table(pa.table(columns), sink)
    return sink.getvalue()


def zipped(*members: tuple[str, bytes]) -> bytes:
    """Return a zip file."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members:
            archive.writestr(name, content)
    return file.getvalue()


def gzip_bomb(size: int) -> bytes:
    """Return a gzip file of ``size`` zeros."""
    packer = zlib.compressobj(9, zlib.DEFLATED, 31)
    block = b"0" * 2**20
    return b"".join([*(packer.compress(block) for _ in range(size // len(block))), packer.flush()])


def zip_bomb(name: str) -> bytes:
    """Return a zip file that states that its one member unpacks to 4 GB."""
    data = bytearray(zipped((name, b"0" * 1000)))
    for mark, offset in ((b"PK\x03\x04", 22), (b"PK\x01\x02", 24)):
        place = data.index(mark) + offset
        data[place : place + 4] = (2**32 - 2).to_bytes(4, "little")
    return bytes(data)


def submission(*members: tuple[str, bytes], **stated: object) -> bytes:
    """Return a submission of files by name, each a cell of the manifest."""
    cells = [{"identity": name.removeprefix("rows/").removesuffix(".json")} for name, _ in members]
    manifest = {"format": 2, "method": "ls", "cells": cells, **stated}
    return zipped(("manifest.json", json.dumps(manifest).encode()), *members)


def cell(npz: bytes) -> tuple[str, bytes]:
    """Return a sealed file of a cell that states almost nothing, with these arrays."""
    rows = {name: [0] for name in ("replicate", "evaluations", "wall_s", "cpu_s", "peak_memory_mb")}
    content: dict[str, object] = {
        "identity": IDENTITY, "cell": {"method": "ls", "label": "ls", "system": "sdof", "snr_db": 20.0},
        "rows": {**rows, "status": ["ok"], "message": [""], "data": [""], "scores": {"rmse": [0.1]}},
        "summary": {}, "prior_share": {}, "identifiable": {}, "wall_s": 0.0, "provenance": {}, "version": {},
        "statuses": {"ok": 1}, "tracebacks": "", "npz": base64.b64encode(npz).decode(),
    }  # fmt: skip
    return f"rows/{IDENTITY}.json", resealed(content)


def aliases(levels: int) -> bytes:
    """Return a scenario of nine to the power of ``levels`` words, by aliases."""
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, levels)]
    return (SDOF + "\n".join(lines) + "\n").encode()


FILES: dict[str, Callable[[], bytes]] = {
    "good.csv": GOOD.encode,
    "file": b"precious\n".__bytes__,
    "random": lambda: np.random.default_rng(0).bytes(4096),
    "header.csv": b"t (s),x (m)\n".__bytes__,
    "backwards.csv": lambda: rows(lambda i, t, x: f"{-t:.1f},{x:.4f}"),
    "hugevalues.csv": lambda: rows(lambda i, t, x: f"{t:.1f},{x * 1e300:.4e}"),
    "ragged.csv": lambda: rows(lambda i, t, x: f"{t:.1f},{x:.4f}" + ",1" * (i % 3 == 1)),
    "bomb.gz": lambda: gzip_bomb(300 * 2**20),
    "bomb.zip": lambda: zip_bomb("record.csv"),
    "random.yaml": lambda: np.random.default_rng(2).bytes(4096),
    "list.yaml": b"[1, 2]\n".__bytes__,
    "nothing.yaml": b"".__bytes__,
    "open.yaml": b"label: [\n".__bytes__,
    "typo.yaml": b"defaults: [sdof]\nsamplez: 3\n".__bytes__,
    "bomb.yaml": lambda: aliases(9),
    "deep.yaml": SDOF.replace("{}", "{a: " + "[" * 20_000 + "]" * 20_000 + "}").encode,
    "tag.yaml": b"!!python/object/apply:os.system ['true']\n".__bytes__,
    "twice.yaml": (SDOF + "label: again\n").encode,
    "half.yaml": SDOF.replace("c: 0.4, ", "").encode,
    "base.yaml": ("defaults: [nowhere]\n" + SDOF).encode,
    "secret.yaml": SDOF.replace("own", "${oc.env:HOME}").encode,
    "wrongprior.yaml": (SDOF + "default_prior: zz\n").encode,
    "later.submission": lambda: submission(format=99),
    "lacking.submission": lambda: submission(cells=[{"identity": IDENTITY}]),
    "huge.submission": lambda: zip_bomb("manifest.json"),
    "arrays.submission": lambda: submission(cell(zip_bomb("times.npy"))),
    "looping.py": b"while True:\n    pass\n".__bytes__,
    "dying.py": b"import os\nos.kill(os.getpid(), 9)\n".__bytes__,
    "syntax.py": b"class Own(:\n".__bytes__,
    "state.json": b"[1, 2]".__bytes__,
}
INJECTION = b"[project.entry-points.'bench.methods']\n\"own = os:system\\nx\" = 'raising:Own'\n"


class Shelf:
    """A folder in which the files are made once, and from which they are linked to where a command runs."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def lay_out(self, place: Path, line: str, store: Path) -> None:
        """Put what a command line names into a folder; ``store`` is one with a cell."""
        for name in (name for name in FILES if name in line):
            made = self.folder / name
            if not made.exists():
                made.write_bytes(FILES[name]())
            (place / name).symlink_to(made)
        if "=store" in line:
            (place / "store").symlink_to(store)
        if "=pipe" in line:
            os.mkfifo(place / ("pipe.yaml" if "pipe.yaml" in line else "pipe"))
        if "=folder" in line or "store=empty" in line:
            (place / ("folder" if "=folder" in line else "empty")).mkdir()
        elif "=empty" in line:
            (place / "empty").touch()
        if "lines_toml" in line:
            (place / "lines_toml").mkdir()
            (place / "lines_toml" / "pyproject.toml").write_bytes(INJECTION)
        for name in ("gigabyte", "huge.yaml"):
            if name in line:
                with open(place / name, "wb") as file:
                    file.truncate(2**30)  # zeros that take no room
