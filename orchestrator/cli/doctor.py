"""`robogauntlet doctor`: check that everything works on this machine."""

from __future__ import annotations

import os
import platform
import shutil
import tempfile
from importlib import metadata

import typer
from rich.table import Table

from robogauntlet.adapters import catalog
from robogauntlet.orchestrator.cli.common import fail, out
from robogauntlet.orchestrator.environments.probe import probe
from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
from robogauntlet.policies import catalog as policies
from robogauntlet.policies import oracles

MIN_DISK_GB = 2.0


def doctor() -> None:
    """Check that every simulator opens and renders on this machine.

    Each simulator is opened in a separate process and renders one frame. Exit code 1 if something does not work.
    """
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    ray = metadata.version("ray")
    out.print(f"Python {platform.python_version()}, Ray {ray}, {os.cpu_count()} cores, {memory:.0f} GiB memory")
    names = [name for name, simulator in catalog.simulators().items() if not simulator.internal]
    environments = EnvironmentResolver()
    with out.status("opening the simulators"):
        findings = probe(names, environments)
    table = Table("simulator", "version", "renders on", "one frame", box=None, pad_edge=False)
    for finding in findings:
        versions = ", ".join(f"{name} {version}" for name, version in finding.versions.items())
        frame = f"{finding.frame_ms:.0f} ms" if finding.frame_ms else ""
        device = "does not work" if finding.problem else finding.render_device
        table.add_row(finding.simulator, versions, device, frame)
    out.print(table)
    problems = [f"{finding.simulator}: {finding.problem}" for finding in findings if finding.problem]
    problems += broken_plugins()
    problems += _machine_problems()
    for problem in problems:
        fail(problem)
    if problems:
        raise typer.Exit(1)
    out.print("everything works")


def broken_plugins() -> list[str]:
    """A line for each simulator, policy and oracle whose entry point cannot be loaded."""
    kinds = {"simulator": catalog, "policy": policies, "oracle": oracles}
    return [
        f"{kind} {plugin.name}: {plugin.reason}" for kind, module in kinds.items() for plugin in module.broken_plugins()
    ]


def _machine_problems() -> list[str]:
    problems: list[str] = []
    try:
        import imageio_ffmpeg

        imageio_ffmpeg.get_ffmpeg_exe()
    except (ImportError, RuntimeError) as error:
        problems.append(f"videos cannot be written: {error}; pip install imageio-ffmpeg")
    here, ray = f"this folder; a run with videos needs up to {MIN_DISK_GB:g} GB", "where Ray keeps its files"
    for folder, place in ((".", here), (tempfile.gettempdir(), f"{tempfile.gettempdir()}, {ray}")):
        free = shutil.disk_usage(folder).free / 1e9
        if free < MIN_DISK_GB:
            problems.append(f"only {free:.1f} GB are free in {place}")
    return problems
