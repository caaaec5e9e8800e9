"""Claims, which prevent several runs on one store from computing the same cell at the same time.

A claim is a locked file that names its holder. The operating system releases the lock when the holder ends for any
reason. On a file system without locks, a cell may be computed twice, but is stored once.
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
"""Length of the text of a claim (bytes), padded to overwrite that of an abandoned claim."""
NO_LOCKS = (errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP)


class Claims:
    """Claims of one run, in a folder shared by all runs on the store."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._locks: dict[str, FileLock | None] = {}

    def prepare(self) -> None:
        """Make the folder with the permissions of the store; raises InputError if this user cannot write in it."""
        try:
            if not self.folder.is_dir():
                self.folder.mkdir(parents=True, exist_ok=True)
                with contextlib.suppress(OSError):  # another user's run may have made it meanwhile
                    self.folder.chmod(self.folder.parent.stat().st_mode & 0o7777)
            tempfile.TemporaryFile(dir=self.folder).close()
        except OSError as error:
            raise self._unusable(error) from None

    def take(self, identity: str) -> bool:
        """Claim a cell; returns False if another run has claimed it. Raises InputError if no claim can be made."""
        from filelock import FileLock, Timeout

        if identity in self._locks:
            return True
        path = self.folder / f"{identity}.claim"
        for _ in range(2):
            try:
                mode = self.folder.stat().st_mode & 0o666
                lock = FileLock(
                    path, blocking=False, mode=mode, thread_local=False, fallback_to_soft=False, on_acquired=self._sign
                )
                lock.acquire()
                self._locks[identity] = lock
                return True
            except Timeout:
                return False
            except FileNotFoundError:
                self.prepare()
            except OSError as error:
                if error.errno in NO_LOCKS:
                    self._locks[identity] = None
                    return True
                if isinstance(error, PermissionError) and path.exists():  # a claim of another user
                    return False
                raise self._unusable(error) from None
        return False

    def holder(self, identity: str) -> str:
        """Describe the run that has claimed a cell."""
        with contextlib.suppress(OSError):
            text = read_regular(self.folder / f"{identity}.claim")[:LONGEST].decode(errors="replace")
            if text.startswith("process "):
                return shortened(text)
        return "unknown process"

    def release(self, identity: str) -> None:
        """Release a claim; the file is deleted before it is unlocked, so that no other run can lock a deleted file."""
        if identity in self._locks:
            lock = self._locks.pop(identity)
            with contextlib.suppress(OSError):
                (self.folder / f"{identity}.claim").unlink()
            if lock is not None:
                lock.release()

    def release_all(self) -> None:
        """Release all claims."""
        for identity in list(self._locks):
            self.release(identity)

    def _sign(self, handle: int) -> None:
        try:
            user = getpass.getuser()
        except (OSError, KeyError):  # a user without a name, as in a container
            user = str(os.getuid())
        with contextlib.suppress(OSError):  # the disk may be full
            os.pwrite(handle, f"process {os.getpid()} of {user} on {platform.node()}".ljust(LONGEST).encode(), 0)

    def _unusable(self, error: OSError) -> InputError:
        try:
            owner = f", owned by {self.folder.owner()}"
        except (OSError, KeyError, NotImplementedError):
            owner = ""
        remedy = f"cannot be written ({error.strerror}{owner}); all users of the store need write permission"
        return InputError("store", self.folder, remedy)
