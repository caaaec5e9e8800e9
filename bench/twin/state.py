"""The saved state of a session as a JSON file, from which a killed run continues.

The file contains data only, nothing that could be executed. A state is valid only for the same method, settings and
layout.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np

from bench.contract.online import Layout, OnlineIdentifier, Tracker
from bench.errors import InputError
from bench.files import write_whole
from bench.twin.filtering import Filter


def digest(method: OnlineIdentifier, layout: Layout, filtered: Filter) -> str:
    """Return a digest of the method, layout and filter to which a state belongs."""
    return hashlib.sha256(f"{method!r} {layout!r} {filtered.band}".encode()).hexdigest()[:20]


def save(path: Path, method: OnlineIdentifier, tracker: Tracker, filtered: Filter) -> None:
    """Write the state atomically; raises InputError if it cannot be written."""
    content = {
        "of": digest(method, tracker.layout, filtered), "samples": tracker.samples,
        "interval": filtered.interval, "decimate": filtered.decimate,
        "filter": {name: plain(value) for name, value in filtered.saved().items()},
        "tracker": {name: plain(value) for name, value in tracker.saved().items()},
    }  # fmt: skip
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, json.dumps(content).encode())
    except OSError as error:
        raise InputError("state", path, f"cannot be written: {error.strerror}") from None


def read(path: Path) -> dict[str, Any]:
    """Return the content of a state file; raises InputError if it is missing or invalid."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        parts = [content["tracker"], content["filter"]]
        if all(isinstance(part, dict) for part in parts) and 0 < content["interval"] < float("inf"):
            int(content["decimate"])
            return dict(content)
    except FileNotFoundError:
        raise InputError("state", path, "file not found; leave resume out to begin a new session") from None
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        pass
    raise InputError("state", path, "not a state file of this command")


def resume(path: Path, content: dict[str, Any], method: OnlineIdentifier, layout: Layout, filtered: Filter) -> Tracker:
    """Return the tracker of a saved state, and restore the filter; raises InputError for another method or layout."""
    if content.get("of") != digest(method, layout, filtered):
        raise InputError("state", path, "was saved with another method, setting or layout; use these, or another file")
    try:
        for name in filtered.saved():
            setattr(filtered, name, restored(content["filter"][name]))
        return method.start(layout).restored({name: restored(value) for name, value in content["tracker"].items()})
    except (KeyError, TypeError, ValueError):
        raise InputError("state", path, "not a state file of this command") from None


def plain(value: Any) -> Any:
    """Convert a value to plain values for JSON."""
    if isinstance(value, np.ndarray):
        return {"array": value.ravel().tolist(), "shape": list(value.shape), "type": value.dtype.str}
    if isinstance(value, list):
        return [plain(item) for item in value]
    return value.item() if isinstance(value, np.generic) else value


def restored(value: Any) -> Any:
    """Convert the result of :func:`plain` back to the value."""
    if isinstance(value, dict):
        return np.array(value["array"], dtype=np.dtype(value["type"])).reshape(value["shape"])
    return [restored(item) for item in value] if isinstance(value, list) else value
