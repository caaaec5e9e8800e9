"""Claims: several runs on one store do not compute the same cell at the same time.

A claim is a locked file. The system lets go of it when its holder ends, however that happens; where the file system
knows no locks, cells may be computed twice, and are still stored once.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
from pathlib import Path


class Claims:
    """Claims of one run, as files of a folder that all runs on the store see."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._held: dict[str, int] = {}

    def take(self, identity: str) -> bool:
        """Claim a cell; False where another run has it."""
        if identity in self._held:
            return True
        self.folder.mkdir(parents=True, exist_ok=True)
        path = self.folder / f"{identity}.claim"
        while True:
            handle = os.open(path, os.O_CREAT | os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW, 0o666)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                os.close(handle)
                return False
            except OSError:  # no locks here
                self._held[identity] = handle
                return True
            if _still_there(path, handle):
                self._held[identity] = handle
                return True
            os.close(handle)  # its holder let go, and removed it, between the two lines above

    def release(self, identity: str) -> None:
        """Give a cell back; the file goes while it is still locked, so that nobody locks one that is going."""
        handle = self._held.pop(identity, None)
        if handle is not None:
            with contextlib.suppress(OSError):
                (self.folder / f"{identity}.claim").unlink()
            os.close(handle)

    def release_all(self) -> None:
        for identity in list(self._held):
            self.release(identity)


def under_way(folder: Path) -> dict[str, float]:
    """The cells that a run has claimed now, and since when (seconds of the clock that files are stamped with).

    A claim whose holder has ended without giving it back is not locked, and not counted; where the file system knows
    no locks, every claim is.
    """
    found = {}
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            name, _, ending = entry.name.rpartition(".")
            with contextlib.suppress(OSError):  # given back in between
                if ending == "claim" and _locked(Path(entry.path)):
                    found[name] = entry.stat().st_mtime
    return found


def _locked(path: Path) -> bool:
    handle = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:  # held, or no locks here
        return True
    finally:
        os.close(handle)
    return False


def _still_there(path: Path, handle: int) -> bool:
    try:
        return os.path.samestat(os.stat(path), os.fstat(handle))
    except OSError:
        return False
