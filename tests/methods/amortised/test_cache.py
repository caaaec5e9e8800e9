"""Trained networks on disk: trained once by many at a time, whole files only, and no need of a disk."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import numpy as np

from methods.amortised.cache import Arrays, cached

IDENTITY = {"samples": 25}


class Maker:
    """Makes arrays, slowly, and counts how often."""

    def __init__(self) -> None:
        self.calls = 0

    def __call__(self) -> Arrays:
        self.calls += 1
        time.sleep(0.1)
        return {"weight": np.arange(6.0).reshape(2, 3)}


def test_many_at_a_time_train_once(tmp_path: Path) -> None:
    make, computed = Maker(), list[Arrays]()
    threads = [threading.Thread(target=lambda: computed.append(cached(tmp_path, IDENTITY, make))) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert make.calls == 1
    assert len(computed) == 4
    for part in computed:
        np.testing.assert_array_equal(part["weight"], np.arange(6.0).reshape(2, 3))
    assert len(list(tmp_path.glob("*.npz"))) == 1
    assert not list(tmp_path.glob("*.tmp"))


def test_a_torn_file_is_made_anew(tmp_path: Path) -> None:
    make = Maker()
    cached(tmp_path, IDENTITY, make)
    file = next(tmp_path.glob("*.npz"))
    file.write_bytes(file.read_bytes()[:100])
    cached(tmp_path, IDENTITY, make)
    cached(tmp_path, IDENTITY, make)
    assert make.calls == 2
