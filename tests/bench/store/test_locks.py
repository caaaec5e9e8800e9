"""Claims say who holds them, and what keeps others from claiming is one line."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from bench.store.locks import Claims


@pytest.fixture
def claims(tmp_path: Path) -> Claims:
    return Claims(tmp_path / "claims")


@pytest.mark.parametrize("text", ["", "{", "\x1b[2J"])
def test_a_claim_that_says_nothing_is_no_error(claims: Claims, text: str) -> None:
    claims.prepare()
    (claims.folder / "held.claim").write_text(text)
    assert claims.holder("held") == "unknown process"
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
def test_a_cell_that_another_user_has_claimed_is_waited_for(tmp_path: Path) -> None:
    """The file of the claim can be read, and not be written; where none can be made, it is one line."""
    ours, shared = tmp_path / "ours", tmp_path / "shared"
    for folder, mode in ((ours, 0o755), (shared, 0o777)):
        folder.mkdir()
        folder.chmod(mode)
    refused = as_another_user(ours)
    assert refused.startswith(f"store={ours}: cannot be written (Permission denied, owned by root)")
    assert len(refused.splitlines()) == 1
    holder = Claims(shared)
    assert holder.take("held")
    (shared / "held.claim").chmod(0o644)
    assert as_another_user(shared) == "False\n"
    holder.release_all()
    assert as_another_user(shared) == "True\n"
