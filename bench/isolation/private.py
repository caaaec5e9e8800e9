"""A folder that its user alone can write: for files that are run, or rebuilt into objects, when they are read."""

from __future__ import annotations

import os
import uuid
from pathlib import Path

from bench.errors import InputError

VARIABLE = "XDG_CACHE_HOME"
NAME = "vibration-bench-launches"
OTHERS = 0o022
"""Rights of the group and of everybody to write."""


def make_private_folder() -> Path:
    """A new folder under the user's cache (``XDG_CACHE_HOME``, else ``~/.cache``); raises InputError."""
    cache = os.environ.get(VARIABLE, "")
    try:
        place = Path(cache or Path.home() / ".cache").resolve() / NAME
        place.parent.mkdir(parents=True, exist_ok=True)
        place.mkdir(mode=0o700, exist_ok=True)
        found = place.stat()
        if found.st_uid != os.geteuid() or found.st_mode & OTHERS:
            raise InputError(VARIABLE, place, "others can write there; name a folder of your own")
        folder = place / uuid.uuid4().hex
        folder.mkdir(mode=0o700)
    except OSError as error:
        raise InputError(VARIABLE, cache, f"cannot be written ({error.strerror}); name another folder") from None
    except RuntimeError:
        raise InputError(VARIABLE, cache, "there is no home folder; name one that is yours alone") from None
    return folder
