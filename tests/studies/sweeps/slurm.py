"""A sweep through Slurm, interrupted and taken up again, or left without its driver: what is stored, and how often.

    python -m tests.studies.sweeps.slurm

Slurm's and munge's daemons run on this machine, in namespaces with no network but loopback, from a configuration that
is written into a temporary folder; they end with this command.
"""

from __future__ import annotations

import os
import secrets
import signal
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path

from tests.studies.sweeps.common import Journal, finish, report, run_apart, start, wait_for

CELLS = 20
SWEEP = (
    "-m", "method=stand_in", "method.seconds=0.2", f"seed=range({CELLS})", "replicates=2", "cells_per_job=2",
    "hydra/launcher=submitit_slurm", "hydra.launcher.partition=debug", "hydra.launcher.timeout_min=10",
)  # fmt: skip
TOOLS = ("munged", "slurmctld", "slurmd", "sbatch", "srun", "squeue", "sinfo")
OPTIONS = """
ClusterName=bench SlurmctldHost=localhost SlurmctldPort=6917 SlurmdPort=6918 SlurmUser=root SlurmdUser=root
AuthType=auth/munge AuthInfo=socket={folder}/munge.socket CredType=cred/munge
StateSaveLocation={folder}/state SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid SlurmdPidFile={folder}/slurmd.pid
SlurmctldLogFile={folder}/slurmctld.log SlurmdLogFile={folder}/slurmd.log
ProctrackType=proctrack/linuxproc TaskPlugin=task/none JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none MpiDefault=none ReturnToService=2
SelectType=select/cons_tres SelectTypeParameters=CR_CPU SchedulerParameters=batch_sched_delay=1,sched_interval=5
"""
NODES = """
NodeName=localhost CPUs={cpus} State=UNKNOWN
PartitionName=debug Nodes=ALL Default=YES MaxTime=INFINITE State=UP
"""


def main() -> int:
    """Run, or say in one line why not."""
    os.environ["PATH"] += ":/usr/sbin:/sbin"
    reason = "" if os.geteuid() == 0 else "Slurm's daemons are started as root here"
    if find_spec("hydra_plugins.hydra_submitit_launcher") is None:
        reason = "hydra-submitit-launcher is not installed (pip install 'vibration-bench[slurm]')"
    return run_apart("tests.studies.sweeps.slurm", TOOLS, reason, _inside)


def _inside(folder: Path) -> int:
    daemons: list[subprocess.Popen[bytes]] = []
    try:
        start_daemons(folder, daemons)
        rows = []
        for name, sent in (("rows", signal.SIGINT), ("others", signal.SIGKILL)):
            rows += _try(folder, name, sent)
        return report(f"{CELLS} cells by Slurm, twice; their driver ended by Ctrl-C, and by kill -9", rows)
    finally:
        for daemon in reversed(daemons):
            daemon.terminate()


def _try(folder: Path, name: str, sent: signal.Signals) -> list[tuple[str, object, object]]:
    """End the driver of a sweep once a third of its cells are stored, wait for its jobs, and run it twice again."""
    (folder / name).mkdir()
    journal = Journal(folder / name)
    line = (*SWEEP, f"store={folder / name}")
    driver = start(folder, *line)
    wait_for(lambda: 3 * len(journal.stored()) >= CELLS or driver.poll() is not None, "a third of the cells", 300)
    driver.send_signal(sent)
    ended, _ = finish(driver)
    wait_for(lambda: not asked("squeue", "-h").strip(), "an empty queue", 300)
    again, _ = finish(start(folder, *line))
    stored = dict(journal.stored())
    last, _ = finish(start(folder, *line))
    more = sum(journal.stored().values()) - sum(stored.values())
    return [
        (f"{name}: exit status of the driver", ended, 130 if sent is signal.SIGINT else -9),
        (f"{name}: run again: exit status, cells stored", (again, len(stored)), (0, CELLS)),
        (f"{name}: cells stored more than once", sum(n > 1 for n in stored.values()), 0),
        (f"{name}: a third run: exit status, cells computed", (last, more), (0, 0)),
    ]


def start_daemons(folder: Path, daemons: list[subprocess.Popen[bytes]]) -> None:
    """Start the daemons, added to ``daemons`` as they come, and wait for the node; SLURM_CONF then names them."""
    folder.chmod(0o755)  # munge's clients must reach its socket
    (folder / "munge.key").write_bytes(secrets.token_bytes(128))
    (folder / "munge.key").chmod(0o600)
    for part in ("state", "spool"):
        (folder / part).mkdir()
    conf = folder / "slurm.conf"
    conf.write_text("\n".join(OPTIONS.format(folder=folder).split()) + NODES.format(cpus=os.cpu_count() or 1))
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


if __name__ == "__main__":
    sys.exit(main())
