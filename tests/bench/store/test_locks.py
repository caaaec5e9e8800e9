"""Claims say who holds them, and what keeps others from claiming is one line."""

from __future__ import annotations

import getpass
import os
import platform
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from bench import InputError
from bench.store.locks import Claims

HOLD = """
import sys, time
from pathlib import Path
from bench.store.locks import Claims
claims = Claims(Path(sys.argv[1]))
claims.take("held")
print("held", flush=True)
time.sleep(600)
"""


@pytest.fixture
def claims(tmp_path: Path) -> Claims:
    return Claims(tmp_path / "claims")


@pytest.fixture
def other(claims: Claims) -> Iterator[int]:
    """Another process, which holds the claim ``held``."""
    command = [sys.executable, "-c", HOLD, str(claims.folder)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        yield process.pid
        process.kill()


def test_a_claim_states_who_holds_it(claims: Claims, other: int) -> None:
    assert not claims.take("held")
    assert claims.holder("held") == f"process {other} of {getpass.getuser()} on {platform.node()}"


@pytest.mark.parametrize("text", ["", "{", "\x1b[2J"])
def test_a_claim_that_says_nothing_is_no_error(claims: Claims, text: str) -> None:
    claims.prepare()
    (claims.folder / "held.claim").write_text(text)
    assert claims.holder("held") == "which one, its claim does not say"
    assert claims.take("held")
    assert str(os.getpid()) in claims.holder("held")


def test_the_folder_of_claims_is_for_all_who_may_write_in_the_store(tmp_path: Path) -> None:
    store = tmp_path / "rows"
    store.mkdir()
    store.chmod(0o2777)
    Claims(store / "claims").prepare()
    assert (store / "claims").stat().st_mode & 0o7777 == 0o2777
    assert list((store / "claims").iterdir()) == []


AS_NOBODY = """
import filelock, os, pwd, sys
from pathlib import Path
from bench import InputError
from bench.store.locks import Claims
os.setuid(65534)  # now: as that user it could not have been started from here
claims = Claims(Path(sys.argv[1]))
try:
    claims.prepare()
    print(claims.take("held"))
except InputError as error:
    print(error)
"""


def as_another_user(folder: Path) -> str:
    """What another user is told who claims the cell ``held`` in a folder."""
    for above in folder.parents[:4]:
        above.chmod(0o755)
    done = subprocess.run([sys.executable, "-c", AS_NOBODY, folder], capture_output=True, text=True, timeout=60)
    return done.stdout or done.stderr


@pytest.mark.skipif(os.getuid() != 0, reason="another user can be played by root only")
def test_claims_of_another_user_are_said_in_one_line(tmp_path: Path) -> None:
    ours, everybodys = tmp_path / "ours", tmp_path / "everybody's"
    for folder, mode in ((ours, 0o755), (everybodys, 0o777)):
        folder.mkdir()
        folder.chmod(mode)
    said = f"store={ours}: cells cannot be claimed in it (Permission denied, it belongs to root)"
    told = as_another_user(ours)
    assert told.startswith(said)
    assert len(told.splitlines()) == 1
    assert as_another_user(everybodys) == "True\n"


@pytest.mark.skipif(os.getuid() != 0, reason="another user can be played by root only")
def test_a_cell_that_another_user_has_claimed_is_waited_for(tmp_path: Path) -> None:
    """The file of the claim can be read, and not be written."""
    shared = tmp_path / "shared"
    shared.mkdir()
    shared.chmod(0o777)
    holder = Claims(shared)
    assert holder.take("held")
    (shared / "held.claim").chmod(0o644)
    assert as_another_user(shared) == "False\n"
    holder.release_all()
    assert as_another_user(shared) == "True\n"


def test_a_folder_that_cannot_be_made_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "rows").write_text("a file")
    with pytest.raises(InputError, match="cells cannot be claimed in it") as caught:
        Claims(tmp_path / "rows" / "claims").take("held")
    assert len(str(caught.value).splitlines()) == 1
