"""Memory that is free for this process."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import psutil

CGROUPS = Path("/sys/fs/cgroup")
OWN_CGROUP = Path("/proc/self/cgroup")


def available_memory(cgroups: Path = CGROUPS, own_cgroup: Path = OWN_CGROUP) -> int:
    """Memory that this process can still take (bytes): of the machine, and within the limits of its control groups.

    These are Linux's control groups of version 2, by which containers and Slurm limit memory.
    """
    return min([psutil.virtual_memory().available, *_rooms(cgroups, own_cgroup)])


def _rooms(cgroups: Path, own_cgroup: Path) -> Iterator[int]:
    """What the process's control group, and each that contains it, lets it take (bytes), where there is a limit."""
    try:
        lines = own_cgroup.read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    own = cgroups / next((line.removeprefix("0::/") for line in lines if line.startswith("0::/")), "")
    for group in (own, *own.parents):
        try:
            limit = int((group / "memory.max").read_text(encoding="utf-8"))
            used = int((group / "memory.current").read_text(encoding="utf-8"))
            numbers = dict(map(str.split, (group / "memory.stat").read_text(encoding="utf-8").splitlines()))
            yield max(limit - used + int(numbers["inactive_file"]), 0)
        except (OSError, ValueError, KeyError):  # no such group, or no limit: "max"
            continue
