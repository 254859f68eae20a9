"""`gauntlet doctor`: does everything work on this machine?"""

from __future__ import annotations

import os
import platform
import shutil
import tempfile
from importlib import metadata

import typer
from rich.table import Table

from adapters import catalog
from orchestrator.cli.shared import fail, homes_here, out
from orchestrator.probe import probe
from policies import catalog as policies
from policies import oracles

LOW_DISK_GB = 2.0


def doctor() -> None:
    """Open every simulator and draw a frame; say what works, and how to mend what does not."""
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    ray = metadata.version("ray")
    out.print(f"Python {platform.python_version()}, Ray {ray}, {os.cpu_count()} cores, {memory:.0f} GiB memory")
    names = [name for name, simulator in catalog.simulators().items() if not simulator.internal]
    homes = homes_here()
    with out.status("opening the simulators"):
        findings = probe(names, homes)
    table = Table("simulator", "version", "renders on", "one frame", box=None, pad_edge=False)
    for found in findings:
        versions = ", ".join(f"{name} {version}" for name, version in found.versions.items())
        frame = f"{found.frame_ms:.0f} ms" if found.frame_ms else ""
        table.add_row(found.simulator, versions, found.render_device if not found.problem else "does not work", frame)
    out.print(table)
    problems = [f"{found.simulator}: {found.problem}" for found in findings if found.problem]
    problems += [f"simulator {plugin.name}: {plugin.reason}" for plugin in catalog.broken_plugins()]
    problems += [f"policy {plugin.name}: {plugin.reason}" for plugin in policies.broken_plugins()]
    problems += [f"oracle {plugin.name}: {plugin.reason}" for plugin in oracles.broken_plugins()]
    problems += _surroundings()
    for problem in problems:
        fail(problem)
    if problems:
        raise typer.Exit(1)
    out.print("all is well")


def _surroundings() -> list[str]:
    problems: list[str] = []
    try:
        import imageio_ffmpeg

        imageio_ffmpeg.get_ffmpeg_exe()
    except (ImportError, RuntimeError) as error:
        problems.append(f"videos cannot be written: {error}; pip install imageio-ffmpeg")
    free = shutil.disk_usage(".").free / 1e9
    if free < LOW_DISK_GB:
        problems.append(f"only {free:.1f} GB are free here; a run with videos needs up to {LOW_DISK_GB:g} GB")
    free = shutil.disk_usage(tempfile.gettempdir()).free / 1e9
    if free < LOW_DISK_GB:
        problems.append(f"only {free:.1f} GB are free in {tempfile.gettempdir()}, where Ray keeps its files")
    return problems
