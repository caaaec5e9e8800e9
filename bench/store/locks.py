"""Claims: several runs on one store do not compute the same cell at the same time.

A claim is a locked file that says who holds it. The system lets go of it when its holder ends, however that happens;
where the file system knows no locks, cells may be computed twice, and are still stored once.
"""

from __future__ import annotations

import contextlib
import fcntl
import getpass
import json
import os
import platform
from functools import cached_property
from pathlib import Path

from bench.errors import InputError

MINE = 500
"""Bytes of a claim, more than any name of a user and a machine takes."""


class Claims:
    """Claims of one run, as files of a folder that all runs on the store see."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._held: dict[str, int] = {}

    def prepare(self) -> None:
        """Make the folder, for all who may write in the store; raises InputError where this user cannot claim in it."""
        try:
            if not self.folder.is_dir():
                self.folder.mkdir(parents=True, exist_ok=True)
                with contextlib.suppress(OSError):  # another run has made it, and is another user's
                    self.folder.chmod(self.folder.parent.stat().st_mode & 0o7777)
            probe = self.folder / f"{os.getpid()}.{os.urandom(4).hex()}.probe"
            os.close(os.open(probe, os.O_CREAT | os.O_EXCL | os.O_WRONLY | os.O_CLOEXEC, 0o600))
            probe.unlink()
        except OSError as error:
            raise self._unusable(error) from None

    def take(self, identity: str) -> bool:
        """Claim a cell; False where another run has it. Raises InputError where no claim can be made."""
        if identity in self._held:
            return True
        if not self.folder.is_dir():
            self.prepare()
        path = self.folder / f"{identity}.claim"
        while True:
            try:
                handle = _opened(path)
            except OSError as error:
                raise self._unusable(error) from None
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                os.close(handle)
                return False
            except OSError:  # no locks here
                break
            if _still_there(path, handle):
                break
            os.close(handle)  # its holder let go, and removed it, between the two lines above
        with contextlib.suppress(OSError):  # a claim that another user has left behind, or a full disk
            os.pwrite(handle, self._mine, 0)
        self._held[identity] = handle
        return True

    def holder(self, identity: str) -> str:
        """Who has claimed a cell, in words."""
        try:
            told = json.loads((self.folder / f"{identity}.claim").read_bytes())
            process, user, host = int(told["process"]), str(told["user"]), str(told["host"])
        except (OSError, ValueError, TypeError, KeyError):
            return "which one, its claim does not say"
        return f"process {process} of {user} on {host}{_state(process, host)}"

    @cached_property
    def _mine(self) -> bytes:
        """What a claim of this process says; padded, so that it covers what an abandoned one has said."""
        return json.dumps({"process": os.getpid(), "user": _user(), "host": platform.node()}).ljust(MINE).encode()

    def _unusable(self, error: OSError) -> InputError:
        try:
            owner = f", it belongs to {self.folder.owner()}"
        except (OSError, KeyError, NotImplementedError):
            owner = ""
        remedy = f"cells cannot be claimed in it ({error.strerror}{owner}); let all who share the store write there"
        return InputError("store", self.folder, remedy)

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


def _opened(path: Path) -> int:
    """A file opened to be locked; that of another user, who does not let it be written, is opened to be read."""
    try:
        return os.open(path, os.O_CREAT | os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW, 0o666)
    except PermissionError:
        if not path.exists():
            raise
        return os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW)


def _user() -> str:
    try:
        return getpass.getuser()
    except (OSError, KeyError):  # a number without a name, as in a container
        return str(os.getuid())


def _state(process: int, host: str) -> str:
    """What keeps a process of this machine, if anything does."""
    import psutil  # a mere look at claims does without

    if host != platform.node():
        return ""
    try:
        stopped = psutil.Process(process).status() == psutil.STATUS_STOPPED
    except psutil.Error:
        return ", which has ended or is in another container"
    return f", which is stopped (kill -CONT {process} lets it go on)" if stopped else ""


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
    handle = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW)
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
