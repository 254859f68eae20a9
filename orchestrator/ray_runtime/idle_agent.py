"""Stands in for the agent of Ray's dashboard, without which Ray does not start: names no ports and waits for the end.

A script of its own, which imports nothing that takes time. Its options are the agent's.
"""

import os
import sys
import time
from pathlib import Path

PORTS = ("metrics_agent_port", "metrics_export_port", "dashboard_agent_listen_port")
NONE = "-1"
"""The port of a service that is not offered."""
CHECK_S = 1.0
"""Time between two checks whether Ray, which started this process, still runs (s)."""


def name_ports(folder: Path, node: str) -> None:
    """Write the files that Ray waits for: each appears once it is complete."""
    for port in PORTS:
        partial = folder / f"{port}_{node}.partial"
        partial.write_text(NONE, encoding="ascii")
        partial.replace(partial.with_suffix(""))


if __name__ == "__main__":
    options = dict(word.split("=", 1) for word in sys.argv[1:] if word.startswith("--") and "=" in word)
    ray = int(os.environ["RAY_RAYLET_PID"])  # the parent may have died already
    name_ports(Path(options["--session-dir"]), options["--node-id"])
    while os.getppid() == ray:
        time.sleep(CHECK_S)
