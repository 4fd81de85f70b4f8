"""A SLURM of one node, this machine, for as long as it is needed; nothing outside a directory is touched."""

import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

NEEDED = ("slurmctld", "slurmd", "srun")  # Debian: slurmctld slurmd slurm-client
CONFIG = """
ClusterName=test
SlurmctldHost={host}(127.0.0.1)
SlurmUser=root
SlurmdUser=root
AuthType=auth/none
CredType=cred/none
AuthInfo=cred_expire=5
MpiDefault=none
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
SwitchType=switch/none
ReturnToService=2
StateSaveLocation={root}/state
SlurmdSpoolDir={root}/spool
SlurmctldPidFile={root}/slurmctld.pid
SlurmdPidFile={root}/slurmd.pid
SlurmctldLogFile={root}/slurmctld.log
SlurmdLogFile={root}/slurmd.log
SlurmctldPort=16817
SlurmdPort=16818
KillWait=5
MinJobAge=300
JobRequeue=1
SchedulerParameters=batch_sched_delay=0,sched_interval=1
NodeName={host} NodeAddr=127.0.0.1 CPUs={cpus} Boards=1 SocketsPerBoard=1 CoresPerSocket={cpus} ThreadsPerCore=1 RealMemory={memory_mb}
PartitionName=main Nodes={host} Default=YES MaxTime=INFINITE State=UP
"""
# submitit asks sacct how jobs ended. That takes an accounting database; the controller remembers them for MinJobAge, too
SACCT = """#!/bin/sh
while [ "$1" != -j ]; do shift; done
echo "JobID|State|NodeList"
squeue -h -r -t all -j "$2" -o "%i|%T|%N"
"""


def missing() -> list[str]:
    """The programs that it takes and that are not there."""
    return [program for program in NEEDED if shutil.which(program) is None]


@contextmanager
def one_node_slurm(root: Path) -> Iterator[dict[str, str]]:
    """Start it and stop it.

    Args:
        root: Where its files go.

    Yields:
        What a command needs in its environment to talk to it.
    """
    host = subprocess.run(["hostname", "-s"], capture_output=True, text=True, check=True).stdout.strip()
    for name in ("state", "spool", "bin"):
        (root / name).mkdir(parents=True)
    config = root / "slurm.conf"
    memory_mb = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") >> 20
    config.write_text(CONFIG.format(host=host, root=root, cpus=os.cpu_count(), memory_mb=memory_mb))
    sacct = root / "bin" / "sacct"
    sacct.write_text(SACCT)
    sacct.chmod(0o755)
    environment = {**os.environ, "SLURM_CONF": str(config), "PATH": f"{sacct.parent}:{os.environ['PATH']}"}
    daemons = [subprocess.Popen([name, "-D"], env=environment, cwd=root) for name in ("slurmctld", "slurmd")]
    try:
        _wait_until_idle(environment, root)
        yield environment
    finally:
        for daemon in reversed(daemons):
            daemon.terminate()
            daemon.wait(timeout=30)


def _wait_until_idle(environment: dict[str, str], root: Path) -> None:
    for _ in range(60):
        said = subprocess.run(["sinfo", "-h", "-o", "%T"], env=environment, capture_output=True, text=True, check=False)
        if said.stdout.strip() == "idle":
            return
        time.sleep(0.5)
    raise RuntimeError(f"SLURM did not start: {said.stdout}{said.stderr}; see {root}/slurmctld.log and slurmd.log")
