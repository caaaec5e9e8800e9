"""A sweep through Slurm, interrupted and taken up again, or left without its driver: what is stored, and how often.

    python -m tests.studies.sweeps.slurm

Slurm's and munge's daemons run on this machine, in namespaces with no network but loopback, from a configuration that
is written into a temporary folder; they end with this command.
"""

from __future__ import annotations

import os
import secrets
import shutil
import signal
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from tabulate import tabulate

from bench.store.store import Store
from tests.studies.sweeps.apart import run_apart, wait_for, why_not
from tests.studies.sweeps.journal import Journal

SEEDS = 10
SWEEP = ("method=ls,shooting", f"seed=range({SEEDS})", "replicates=2", "cells_per_job=2")
CELLS = 2 * SEEDS
SLURM = ("hydra/launcher=submitit_slurm", "hydra.launcher.partition=debug", "hydra.launcher.timeout_min=10")
TOOLS = ("munged", "slurmctld", "slurmd", "sbatch", "srun", "squeue", "sinfo")
CONFIGURATION = """
ClusterName=bench
SlurmctldHost=localhost
SlurmctldPort=6917
SlurmdPort=6918
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket={folder}/munge.socket
CredType=cred/munge
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
MpiDefault=none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
ReturnToService=2
SchedulerParameters=batch_sched_delay=1,sched_interval=5
NodeName=localhost CPUs={cpus} State=UNKNOWN
PartitionName=debug Nodes=ALL Default=YES MaxTime=INFINITE State=UP
"""


def main() -> int:
    """Run, or say in one line why not."""
    os.environ["PATH"] += ":/usr/sbin:/sbin"
    tool = next((name for name in TOOLS if shutil.which(name) is None), "")
    reason = f"{tool} is not installed" if tool else why_not()
    if not reason and find_spec("hydra_plugins.hydra_submitit_launcher") is None:
        reason = "hydra-submitit-launcher is not installed (pip install 'vibration-bench[slurm]')"
    if not reason and os.geteuid() != 0:
        reason = "Slurm's daemons are started as root here"
    return run_apart("tests.studies.sweeps.slurm", reason, _inside)


def _inside(folder: Path) -> int:
    daemons: list[subprocess.Popen[bytes]] = []
    try:
        start(folder, daemons)
        return _try(folder)
    except (RuntimeError, TimeoutError) as error:
        logs = [path.read_text(errors="replace")[-1500:] for path in sorted(folder.glob("*.log"))]
        print(f"slurm: {error}", *logs, sep="\n", file=sys.stderr)
        return 1
    finally:
        for daemon in reversed(daemons):
            daemon.terminate()


def start(folder: Path, daemons: list[subprocess.Popen[bytes]]) -> None:
    """Start the daemons, added to ``daemons`` as they come, and wait for the node; SLURM_CONF then names them."""
    folder.chmod(0o755)  # munge's clients must reach its socket
    (folder / "munge.key").write_bytes(secrets.token_bytes(128))
    (folder / "munge.key").chmod(0o600)
    for part in ("state", "spool"):
        (folder / part).mkdir()
    cpus = os.cpu_count() or 1
    conf = folder / "slurm.conf"
    conf.write_text(CONFIGURATION.format(folder=folder, cpus=cpus))
    os.environ["SLURM_CONF"] = str(conf)
    munge = [f"--{kind}={folder}/munge.{kind.removesuffix('-file')}" for kind in ("key-file", "pid-file", "seed-file")]
    places = [f"--socket={folder}/munge.socket", f"--log-file={folder}/munge.log"]
    for command in (["munged", "--foreground", "--force", *munge, *places], ["slurmctld", "-D"], ["slurmd", "-D"]):
        with (folder / f"{command[0]}.out.log").open("wb") as log:
            daemons.append(subprocess.Popen(command, stdout=log, stderr=log))
        time.sleep(1.0)
    wait_for(lambda: b"idle" in asked("sinfo", "-h", "-o", "%T"), "the node's state idle", 60)


def asked(*command: str) -> bytes:
    """What a command prints."""
    return subprocess.run(command, capture_output=True).stdout


def _try(folder: Path) -> int:
    one, two = Store(folder / "rows"), Store(folder / "others")
    journals = {}
    for store in (one, two):
        store.prepare()
        journals[store.folder] = Journal(store.folder)
    rows = [
        _row("run, Ctrl-C for its driver", one, journals, signal.SIGINT),
        _row("run again", one, journals),
        _row("and again", one, journals),
        _row("another store, kill -9 for the driver", two, journals, signal.SIGKILL),
        _row("run again", two, journals),
    ]
    headers = ["", "exit status", "s", "s until the queue was empty", "cells computed", "cells stored"]
    print(tabulate(rows, headers=headers))
    twice = sum(n > 1 for journal in journals.values() for n in journal.stored().values())
    print(f"of 2 x {CELLS} cells {len(one.identities()) + len(two.identities())} are stored, {twice} more than once")
    statuses, computed = [row[1] for row in rows], [row[4] for row in rows]
    good = statuses == [130, 0, 0, -9, 0] and twice == 0 and computed[2] == computed[4] == 0
    return 0 if good and [row[5] for row in rows[1:]] == [CELLS] * 4 else 1


def _row(what: str, store: Store, journals: dict[Path, Journal], sent: signal.Signals | None = None) -> list[Any]:
    """One run, its driver sent a signal once a third of the cells are stored; the queue then empties by itself."""
    journal = journals[store.folder]
    before, started = sum(journal.stored().values()), time.monotonic()
    command = [sys.executable, "-m", "bench", "-m", *SWEEP, f"store={store.folder}", *SLURM]
    with (store.folder.parent / "driver.log").open("wb") as file:
        driver = subprocess.Popen(command, stdout=file, stderr=file)
    if sent is not None:
        wait_for(lambda: 3 * len(journal.stored()) >= CELLS or driver.poll() is not None, "a third of the cells", 300)
        driver.send_signal(sent)
    status = driver.wait(timeout=600)
    seconds = time.monotonic() - started
    wait_for(lambda: not asked("squeue", "-h").strip(), "an empty queue", 300)
    drained = time.monotonic() - started - seconds
    stored = journal.stored()
    return [what, status, f"{seconds:.0f}", f"{drained:.0f}", sum(stored.values()) - before, len(stored)]


if __name__ == "__main__":
    sys.exit(main())
