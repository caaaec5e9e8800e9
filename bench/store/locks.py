"""Claims: several runs on one store do not compute the same cell at the same time.

A claim is a file locked by filelock that names its holder. The system unlocks it when the holder ends, however that
happens; where the file system has no locks, cells may be computed twice, and are still stored once.
"""

from __future__ import annotations

import contextlib
import errno
import getpass
import os
import platform
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from bench.errors import InputError, shortened
from bench.files import read_regular

if TYPE_CHECKING:
    from filelock import FileLock

LONGEST = 500
"""Bytes of a claim, more than the names of a user and a machine take: it covers what an abandoned one holds."""
NO_LOCKS = (errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP)


class Claims:
    """Claims of one run, as files of a folder that all runs on the store see."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._held: dict[str, FileLock | None] = {}

    def prepare(self) -> None:
        """Make the folder, for all who may write in the store; raises InputError where this user cannot claim in it."""
        try:
            if not self.folder.is_dir():
                self.folder.mkdir(parents=True, exist_ok=True)
                with contextlib.suppress(OSError):  # another run has made it, and is another user's
                    self.folder.chmod(self.folder.parent.stat().st_mode & 0o7777)
            tempfile.TemporaryFile(dir=self.folder).close()
        except OSError as error:
            raise self._unusable(error) from None

    def take(self, identity: str) -> bool:
        """Claim a cell; returns False where another run has it. Raises InputError where no claim can be made."""
        from filelock import FileLock, Timeout

        if identity in self._held:
            return True
        path = self.folder / f"{identity}.claim"
        for _ in range(2):
            try:
                mode = self.folder.stat().st_mode & 0o666
                lock = FileLock(
                    path, blocking=False, mode=mode, thread_local=False, fallback_to_soft=False, on_acquired=self._sign
                )
                lock.acquire()
                self._held[identity] = lock
                return True
            except Timeout:
                return False
            except FileNotFoundError:
                self.prepare()
            except OSError as error:
                if error.errno in NO_LOCKS:
                    self._held[identity] = None
                    return True
                if isinstance(error, PermissionError) and path.exists():  # another user's
                    return False
                raise self._unusable(error) from None
        return False

    def holder(self, identity: str) -> str:
        """Describe who has claimed a cell."""
        with contextlib.suppress(OSError):
            text = read_regular(self.folder / f"{identity}.claim")[:LONGEST].decode(errors="replace")
            if text.startswith("process "):
                return shortened(text)
        return "which one, its claim does not say"

    def release(self, identity: str) -> None:
        """Give a cell back; the file goes while it is still locked, so that nobody locks one that is going."""
        if identity in self._held:
            lock = self._held.pop(identity)
            with contextlib.suppress(OSError):
                (self.folder / f"{identity}.claim").unlink()
            if lock is not None:
                lock.release()

    def release_all(self) -> None:
        """Give all cells back."""
        for identity in list(self._held):
            self.release(identity)

    def _sign(self, handle: int) -> None:
        try:
            user = getpass.getuser()
        except (OSError, KeyError):  # a number without a name, as in a container
            user = str(os.getuid())
        with contextlib.suppress(OSError):  # a full disk
            os.pwrite(handle, f"process {os.getpid()} of {user} on {platform.node()}".ljust(LONGEST).encode(), 0)

    def _unusable(self, error: OSError) -> InputError:
        try:
            owner = f", it belongs to {self.folder.owner()}"
        except (OSError, KeyError, NotImplementedError):
            owner = ""
        remedy = f"cells cannot be claimed in it ({error.strerror}{owner}); let all who share the store write there"
        return InputError("store", self.folder, remedy)


def under_way(folder: Path) -> dict[str, float]:
    """Return the cells that runs have claimed, and since when (seconds of the clock that files are stamped with).

    A claim whose holder has ended without giving it back is not locked, and not counted; where the file system has no
    locks, or the claim is another user's, it is.
    """
    from filelock import FileLock, Timeout

    claimed = {}
    for path in folder.glob("*.claim"):
        with contextlib.suppress(FileNotFoundError):  # given back in between
            since = path.stat().st_mtime
            try:
                FileLock(path, blocking=False, fallback_to_soft=False).acquire().lock.release()
            except (Timeout, PermissionError):
                claimed[path.stem] = since
            except OSError as error:
                if error.errno in NO_LOCKS:
                    claimed[path.stem] = since
    return claimed
