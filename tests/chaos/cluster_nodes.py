"""Nodes of a cluster as Linux namespaces: each has its own network address, host name, and folders for temporary files.

They share this machine's files, cores and packages. Everything of a node ends with its `sleep`.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import psutil

PORT = 6379
JOIN_S = 180.0
"""Time for a node to join the cluster (s)."""
END_S = 10.0
_INIT = "import os, signal; signal.signal(signal.SIGCHLD, signal.SIG_IGN); os.execlp('sleep', 'sleep', 'infinity')"
"""First process of a node. It leaves no zombies: Ray's workers would take a dead raylet for a living one."""
_TOOLS = ("unshare", "nsenter", "ip", "mount")


def why_not() -> str | None:
    """Why this machine cannot make the namespaces, or None."""
    try:
        probe = ["unshare", "--net", "--mount", "--uts", "ip", "link", "add", "name", "probe", "type", "bridge"]
        made = subprocess.run(probe, capture_output=True, text=True, timeout=10)
    except (OSError, subprocess.SubprocessError) as error:
        return f"not installed: {', '.join(_TOOLS)}: {error}"
    return f"this machine allows no namespaces: {made.stderr.strip()}" if made.returncode else None


class Node:
    """A machine, as far as Ray can tell."""

    def __init__(self, number: int, private: Sequence[Path]) -> None:
        """Create the namespaces; the folders `private` are empty there, and other nodes do not see what it writes."""
        self.address, self.name = f"10.77.0.{number}", f"node{number}"
        separate = ["--net", "--mount", "--uts", "--pid", "--fork", "--kill-child", "--mount-proc"]
        self._holder = subprocess.Popen(["unshare", *separate, sys.executable, "-c", _INIT])
        self.pid = _holding(self._holder.pid)
        self.run("hostname", self.name)
        self.run("ip", "link", "set", "lo", "up")
        for folder in private:
            self.run("mkdir", "-p", "-m", "700", str(folder))
            self.run("mount", "-t", "tmpfs", "-o", "mode=700", "tmpfs", str(folder))

    def inside(self, *command: str) -> list[str]:
        """The command line that runs a command on this node."""
        return ["nsenter", "--target", str(self.pid), "--net", "--mount", "--uts", "--pid", "--", *command]

    def run(self, *command: str) -> None:
        """Run a command on this node; raises CalledProcessError."""
        subprocess.run(self.inside(*command), check=True, stdout=subprocess.DEVNULL, timeout=JOIN_S)

    def without_package(self, package: Path, scratch: Path) -> None:
        """Hide a folder on this node, and only there; `scratch` is an empty folder."""
        self.run("mount", "-t", "tmpfs", "tmpfs", str(scratch))
        upper, work = scratch / "upper", scratch / "work"
        self.run("mkdir", str(upper), str(work))
        layers = f"lowerdir={package.parent},upperdir={upper},workdir={work}"
        self.run("mount", "-t", "overlay", "overlay", "-o", layers, str(package.parent))
        self.run("rm", "-r", str(package))

    def processes(self) -> list[psutil.Process]:
        """The processes on this node, besides the one that holds its namespaces."""
        own = Path(f"/proc/{self.pid}/ns/pid").readlink()
        found = []
        for process in psutil.process_iter():
            with contextlib.suppress(OSError, psutil.Error):
                if process.pid != self.pid and Path(f"/proc/{process.pid}/ns/pid").readlink() == own:
                    found.append(process)
        return found

    def kill(self) -> None:
        """Kill all that runs on this node, as a power cut does."""
        deadline = time.monotonic() + END_S
        while (left := self.processes()) and time.monotonic() < deadline:
            for process in left:
                with contextlib.suppress(psutil.Error):
                    process.send_signal(signal.SIGKILL)
            time.sleep(0.05)

    def close(self) -> None:
        """Kill all that runs on this node, and remove it."""
        self.kill()
        self._holder.kill()
        self._holder.wait()


class RayCluster:
    """A Ray cluster on nodes that a bridge joins. The first node has the head."""

    def __init__(self, nodes: Sequence[Node], switch: int, folder: Path) -> None:
        """Use these nodes; `switch` is the process that holds the bridge, `folder` gets the logs."""
        self.nodes, self._switch, self._folder = nodes, switch, folder
        self.environment = {
            **{name: value for name, value in os.environ.items() if not name.startswith("RAY_")},
            "RAY_AUTH_MODE": "token",
            "RAY_AUTH_TOKEN": secrets.token_hex(32),
            "RAY_USAGE_STATS_ENABLED": "0",
            "OMP_NUM_THREADS": "1",
        }

    @property
    def address(self) -> str:
        """`HOST:PORT` of the head."""
        return f"{self.nodes[0].address}:{PORT}"

    def start_ray(self, number: int, cpus: int = 1, more: Mapping[str, str] | None = None) -> None:
        """Start Ray on a node, counted from 0, with further environment variables, and wait until it has joined."""
        node = self.nodes[number]
        join = (
            ["--head", f"--port={PORT}", "--include-dashboard=false"] if number == 0 else [f"--address={self.address}"]
        )
        command = [
            *(sys.executable, "-m", "ray.scripts.scripts", "start"),
            *join,
            f"--node-ip-address={node.address}",
            f"--num-cpus={cpus}",
            "--disable-usage-stats",
        ]
        log = self._folder / f"{node.name}.log"
        with log.open("ab") as stream:
            started = subprocess.run(
                node.inside(*command),
                env={**self.environment, **(more or {})},
                stdout=stream,
                stderr=stream,
                timeout=JOIN_S,
            )
        assert started.returncode == 0, log.read_text()

    def popen(
        self, number: int, command: Sequence[str], log: Path, more: Mapping[str, str] | None = None
    ) -> subprocess.Popen[bytes]:
        """Start a command on a node, with further environment variables."""
        inside, environment = self.nodes[number].inside(*command), {**self.environment, **(more or {})}
        with log.open("ab") as stream:
            return subprocess.Popen(inside, env=environment, stdout=stream, stderr=subprocess.STDOUT)

    def cut(self, number: int, *, off: bool) -> None:
        """Disconnect a node from the others, or connect it again."""
        state = "down" if off else "up"
        switch = ["nsenter", "--target", str(self._switch), "--net", "--"]
        subprocess.run([*switch, "ip", "link", "set", f"port{number + 1}", state], check=True, timeout=END_S)


@contextlib.contextmanager
def ray_cluster(folder: Path, nodes: int = 3, private: Sequence[Path] = ()) -> Iterator[RayCluster]:
    """Connected nodes without Ray; each has folders of its own for Ray's files, and for those in `private`.

    Raises:
        CalledProcessError: The namespaces cannot be made; see `why_not`.
    """
    own = [Path("/tmp/ray"), Path("/dev/shm"), *private]
    with contextlib.ExitStack() as stack:
        switch = subprocess.Popen(["unshare", "--net", "sleep", "infinity"])
        stack.callback(switch.wait)
        stack.callback(switch.kill)
        _holding(switch.pid)
        lines = ["ip link add name switch type bridge", "ip link set switch up"]
        made = []
        for number in range(1, nodes + 1):
            made.append(Node(number, own))
            stack.callback(made[-1].close)
            lines += [
                f"ip link add port{number} type veth peer name eth0 netns {made[-1].pid}",
                f"ip link set port{number} master switch up",
            ]
        for line in lines:
            subprocess.run(["nsenter", "--target", str(switch.pid), "--net", "--", *shlex.split(line)], check=True)
        for node in made:
            node.run("ip", "address", "add", f"{node.address}/24", "dev", "eth0")
            node.run("ip", "link", "set", "eth0", "up")
        yield RayCluster(made, switch.pid, folder)


def _holding(pid: int) -> int:
    """The process that holds the namespaces, when `unshare` has made them: `sleep`, itself or its child."""
    deadline = time.monotonic() + END_S
    while time.monotonic() < deadline:
        family = [psutil.Process(pid), *psutil.Process(pid).children()]
        for process in family:
            with contextlib.suppress(psutil.NoSuchProcess):
                if process.name() == "sleep":
                    return process.pid
        time.sleep(0.01)
    raise TimeoutError("unshare has made no namespace")
