"""A SLURM of one node on this machine, for tests: it needs no root, no systemd and no configuration of the system, and ends with its context.

``python tests/cluster/local_slurm.py COMMAND…`` runs a command in which ``sbatch``, ``squeue`` and the others mean this SLURM.
"""

from __future__ import annotations

import os
import pwd
import secrets
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

CLIENTS = ("sbatch", "srun", "squeue", "sinfo", "scontrol", "scancel", "sacct", "sacctmgr")
SERVERS = ("munged", "slurmctld", "slurmd")

INSTALL = "SLURM is not installed; on Debian: apt-get install slurm-wlm munge"

# Accounting, control groups and task binding need services that a container does not have. The status of ended jobs comes from
# squeue, which forgets them after MinJobAge.
CONFIGURATION = """\
ClusterName=test
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={ctld_port}
SlurmdPort={d_port}
SlurmUser={user}
SlurmdUser={user}
AuthType=auth/munge
AuthInfo=socket={folder}/munge.socket
CredType=cred/munge
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd.log
CommunicationParameters=NoInAddrAny,NoCtldInAddrAny
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU_Memory
SchedulerType=sched/backfill
SchedulerParameters=sched_interval=1,bf_interval=1,batch_sched_delay=0,sched_min_interval=0
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
MpiDefault=none
JobAcctGatherType=jobacct_gather/linux
JobAcctGatherFrequency=1
JobAcctGatherParams=OverMemoryKill
AccountingStorageType=accounting_storage/none
JobCompType=jobcomp/none
MinJobAge=3600
KillWait=2
ReturnToService=2
SwitchType=switch/none
NodeName={host} NodeAddr=127.0.0.1 CPUs={cpus} RealMemory={memory} State=UNKNOWN
PartitionName=test Nodes={host} Default=YES MaxTime=INFINITE State=UP
"""


def missing() -> list[str]:
    """Programs of SLURM that this machine does not have."""
    return [name for name in (*SERVERS, *CLIENTS) if _program(name) is None]


@contextmanager
def local_slurm(cpus: int, memory: int) -> Iterator[dict[str, str]]:
    """Start SLURM with a node of some processors and MB of memory, which need not exist; yields the environment for its commands."""
    # A path of a socket has at most 108 bytes, and a folder of pytest may be longer.
    folder = Path(tempfile.mkdtemp(prefix="slurm-"))
    servers: list[subprocess.Popen[bytes]] = []
    try:
        environment = _environment(folder)
        _configure(folder, cpus, memory)
        munge = ["--key-file", folder / "munge.key", "--socket", folder / "munge.socket", "--pid-file", folder / "pid"]
        more = ["--log-file", folder / "munged.log", "--seed-file", folder / "seed", "--force", "--foreground"]
        servers.append(_start("munged", *munge, *more, environment=environment))
        _wait_for("socket of munged", lambda: (folder / "munge.socket").exists(), folder)
        servers.append(_start("slurmctld", "-D", "-c", "-f", folder / "slurm.conf", environment=environment))
        servers.append(
            _start("slurmd", "-D", "-c", "-N", _host(), "-f", folder / "slurm.conf", environment=environment)
        )
        _wait_for("idle node", lambda: _node_state(environment) == "idle", folder)
        yield environment
    finally:
        if len(servers) == 3:
            subprocess.run(["scancel", "--user", _user()], env=environment, capture_output=True, timeout=30)
            time.sleep(1)
        for server in reversed(servers):
            server.terminate()
            try:
                server.wait(timeout=20)
            except subprocess.TimeoutExpired:
                server.kill()
        shutil.rmtree(folder, ignore_errors=True)


def _environment(folder: Path) -> dict[str, str]:
    """The environment, with clients that know their configuration: snakemake's plugin removes all SLURM_ variables, SLURM_CONF too."""
    clients = folder / "bin"
    clients.mkdir()
    for name in CLIENTS:
        client = clients / name
        client.write_text(f'#!/bin/sh\nSLURM_CONF={folder}/slurm.conf exec {_program(name)} "$@"\n')
        client.chmod(0o755)
    kept = {name: value for name, value in os.environ.items() if not name.startswith("SLURM_")}
    return kept | {"PATH": f"{clients}:{os.environ['PATH']}"}


def _configure(folder: Path, cpus: int, memory: int) -> None:
    for name in ("state", "spool"):
        (folder / name).mkdir()
    folder.chmod(0o755)
    key = folder / "munge.key"
    key.write_bytes(secrets.token_bytes(128))
    key.chmod(0o600)
    ports = _free_ports(2)
    (folder / "slurm.conf").write_text(
        CONFIGURATION.format(
            folder=folder, host=_host(), user=_user(), cpus=cpus, memory=memory, ctld_port=ports[0], d_port=ports[1]
        )
    )


def _start(name: str, *arguments: str | Path, environment: dict[str, str]) -> subprocess.Popen[bytes]:
    program = _program(name)
    assert program, INSTALL
    null = subprocess.DEVNULL
    return subprocess.Popen([program, *map(str, arguments)], env=environment, stdin=null, stdout=null, stderr=null)


def _node_state(environment: dict[str, str]) -> str:
    command = ["sinfo", "--noheader", "--format=%t"]
    return subprocess.run(command, env=environment, capture_output=True, text=True).stdout.strip()


def _wait_for(what: str, ready: object, folder: Path, seconds: float = 60) -> None:
    assert callable(ready)
    end = time.monotonic() + seconds
    while not ready():
        if time.monotonic() > end:
            logs = "\n".join(path.read_text(errors="replace")[-2000:] for path in folder.glob("*.log"))
            raise TimeoutError(f"SLURM did not start: no {what} after {seconds:.0f} s\n{logs}")
        time.sleep(0.2)


def _program(name: str) -> str | None:
    return shutil.which(name) or shutil.which(name, path="/usr/sbin:/usr/local/sbin")


def _host() -> str:
    return socket.gethostname().partition(".")[0]


def _user() -> str:
    return pwd.getpwuid(os.getuid()).pw_name


def _free_ports(count: int) -> list[int]:
    sockets = [socket.create_server(("127.0.0.1", 0)) for _ in range(count)]
    ports = [one.getsockname()[1] for one in sockets]
    for one in sockets:
        one.close()
    return ports


if __name__ == "__main__":
    if missing():
        sys.exit(INSTALL)
    with local_slurm(os.cpu_count() or 1, memory=16000) as environment:
        sys.exit(subprocess.run(sys.argv[1:], env=environment).returncode)
