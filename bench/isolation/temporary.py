"""The folder of temporary files, by which a run talks with its processes."""

from __future__ import annotations

import os
import tempfile

from bench.errors import InputError

LONGEST = 75
"""Letters of its path: a socket's is at most 107 on Linux, and Python puts 32 behind the folder's."""


def check_temporary() -> None:
    """Raise InputError where no temporary file can be made, or the path is too long for a socket in it."""
    try:
        folder = tempfile.gettempdir()
    except OSError as error:
        named = os.environ.get("TMPDIR", "")
        raise InputError("TMPDIR", named, f"a folder that can be written ({error.strerror})") from None
    if len(os.fsencode(folder)) > LONGEST:
        raise InputError("TMPDIR", folder, f"a path of at most {LONGEST} letters, which has room for a socket's name")
