"""The state of a twin in a file: all that its tracker holds, as JSON, so that a killed run continues where it was.

Numbers only, nothing that could be executed. A state belongs to one method with its settings and one layout: it is
refused by any other.
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
    """Return the digest of what a state belongs to."""
    return hashlib.sha256(f"{method!r} {layout!r} {filtered.band}".encode()).hexdigest()[:20]


def save(path: Path, method: OnlineIdentifier, tracker: Tracker, filtered: Filter) -> None:
    """Write the state; the file is there whole or as it was. Raises InputError where it cannot be written."""
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
    """Return the content of a state file; raises InputError."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        told = [content["tracker"], content["filter"]]
        if all(isinstance(part, dict) for part in told) and 0 < content["interval"] < float("inf"):
            int(content["decimate"])
            return dict(content)
    except FileNotFoundError:
        raise InputError("state", path, "there is no such file; leave resume out to begin") from None
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        pass
    raise InputError("state", path, "it is not a state file of this command")


def resumed(path: Path, content: dict[str, Any], method: OnlineIdentifier, layout: Layout, filtered: Filter) -> Tracker:
    """Return the tracker of a state and put the filter into it; raises InputError for another method or layout."""
    if content.get("of") != digest(method, layout, filtered):
        raise InputError("state", path, "it belongs to another method, setting or layout; give those, or another file")
    try:
        for name in filtered.saved():
            setattr(filtered, name, restored(content["filter"][name]))
        return method.start(layout).restored({name: restored(value) for name, value in content["tracker"].items()})
    except (KeyError, TypeError, ValueError):
        raise InputError("state", path, "it is not a state file of this command") from None


def plain(value: Any) -> Any:
    """Return a value as JSON holds it."""
    if isinstance(value, np.ndarray):
        return {"array": value.ravel().tolist(), "shape": list(value.shape), "type": value.dtype.str}
    if isinstance(value, list):
        return [plain(item) for item in value]
    return value.item() if isinstance(value, np.generic) else value


def restored(value: Any) -> Any:
    """Return the value that :func:`plain` was given."""
    if isinstance(value, dict):
        return np.array(value["array"], dtype=np.dtype(value["type"])).reshape(value["shape"])
    return [restored(item) for item in value] if isinstance(value, list) else value
