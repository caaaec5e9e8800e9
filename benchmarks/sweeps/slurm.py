"""A sweep through Slurm, interrupted and taken up again: what is stored, and how often.

    python -m benchmarks.sweeps.slurm

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

from tabulate import tabulate

from bench.store import Store
from benchmarks.sweeps.apart import folder_apart, run_apart, wait_for, why_not
from benchmarks.sweeps.journal import Journal

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
    folder = folder_apart()
    if folder is not None:
        return _inside(folder)
    if reason:
        print(f"slurm: skipped: {reason}")
        return 0
    return run_apart("benchmarks.sweeps.slurm")


def _inside(folder: Path) -> int:
    daemons: list[subprocess.Popen[bytes]] = []
    try:
        _start(folder, daemons)
        return _try(Store(folder / "rows"))
    except (RuntimeError, TimeoutError) as error:
        logs = [path.read_text(errors="replace")[-1500:] for path in sorted(folder.glob("*.log"))]
        print(f"slurm: {error}", *logs, sep="\n", file=sys.stderr)
        return 1
    finally:
        for daemon in reversed(daemons):
            daemon.terminate()


def _start(folder: Path, daemons: list[subprocess.Popen[bytes]]) -> None:
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
    wait_for(lambda: b"idle" in _asked("sinfo", "-h", "-o", "%T"), "the node's state idle", 60)


def _asked(*command: str) -> bytes:
    return subprocess.run(command, capture_output=True).stdout


def _try(store: Store) -> int:
    store.prepare()
    journal = Journal(store.folder)
    rows = []
    for what, cut in (("run, interrupted", CELLS // 3), ("run again", None), ("and again", None)):
        before, started = sum(journal.stored().values()), time.monotonic()
        status = _run(store, journal, cut)
        seconds = time.monotonic() - started
        wait_for(lambda: not _asked("squeue", "-h").strip(), "an empty queue", 120)
        drained = time.monotonic() - started - seconds
        times = journal.stored()
        rows.append([what, status, f"{seconds:.0f}", f"{drained:.1f}", sum(times.values()) - before, len(times)])
    headers = ["", "exit status", "s", "s until the queue was empty", "cells computed", "cells stored"]
    print(tabulate(rows, headers=headers))
    here, twice = len(store.identities()), sum(n > 1 for n in journal.stored().values())
    print(f"{here} of {CELLS} cells are in the store; {twice} were stored more than once")
    good = here == CELLS and twice == 0 and rows[0][1] == 130 and [row[1] for row in rows[1:]] == [0, 0]
    return 0 if good and rows[2][4] == 0 else 1


def _run(store: Store, journal: Journal, cut: int | None) -> int:
    """One run, interrupted as by Ctrl-C once so many cells are stored; its exit status."""
    command = [sys.executable, "-m", "bench", "-m", *SWEEP, f"store={store.folder}", *SLURM]
    log = store.folder.parent / "driver.log"
    with log.open("wb") as file:
        driver = subprocess.Popen(command, stdout=file, stderr=file)
    if cut is not None:
        wait_for(lambda: len(journal.stored()) >= cut or driver.poll() is not None, f"{cut} cells", 300)
        driver.send_signal(signal.SIGINT)
    return driver.wait(timeout=600)


if __name__ == "__main__":
    sys.exit(main())
