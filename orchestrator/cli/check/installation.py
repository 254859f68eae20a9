"""`robogauntlet check installation`: check that everything works on this machine."""

from __future__ import annotations

import os
import platform
import shutil
from collections.abc import Sequence
from contextlib import nullcontext
from importlib import metadata

import typer
from rich.table import Table

from robogauntlet.adapters import catalog
from robogauntlet.orchestrator.cli.common import AsJson, fail, out, print_json, print_line
from robogauntlet.orchestrator.environments.probe import Finding, probe
from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
from robogauntlet.orchestrator.ray_runtime.session_folder import LONGEST
from robogauntlet.policies import catalog as policies, oracles
from robogauntlet.support.errors import describe_os_error
from robogauntlet.support.private_folder import new_session_folder

MIN_DISK_GB = 2.0
LISTENS = {
    "Ray, while something is played": "127.0.0.1, ports that it chooses, with a token",
    "robogauntlet serve dashboard": "127.0.0.1, port 8770; elsewhere by --host, with a token",
    "robogauntlet serve policy": "127.0.0.1, port 8000; elsewhere by --host, with a token",
    "robogauntlet.evaluate of an object": "127.0.0.1, any free port, with a token",
}
"""What listens for connections, and where; see docs/operating.md."""


def check(as_json: AsJson = False) -> None:
    """Check that the installed simulators open and render.

    Each simulator is opened in a separate process and renders one frame. Exit code 1 if something that is installed
    does not work, or if no simulator is installed.
    """
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    machine = {"python": platform.python_version(), "ray": metadata.version("ray"), "cores": os.cpu_count()}
    if not as_json:
        out.print("Python {python}, Ray {ray}, {cores} cores".format(**machine) + f", {memory:.0f} GiB memory")
    names = [name for name, simulator in catalog.simulators().items() if not simulator.internal]
    environments = EnvironmentResolver()
    with out.status("opening the simulators") if not as_json else nullcontext():
        findings = probe(names, environments)
    installed = [finding for finding in findings if finding.installed]
    problems = [f"{finding.simulator}: {finding.problem}" for finding in installed if finding.problem]
    if not installed:
        problems.append("no simulator is installed; install one: pip install 'robogauntlet[pybullet]'")
    problems += broken_plugins()
    problems += _machine_problems()
    notes = [f"{finding.simulator}: {finding.problem}" for finding in findings if not finding.installed]
    if as_json:
        found = {"simulators": findings, "problems": problems, "notes": notes, "listens": LISTENS}
        print_json({**machine, "memory_gib": memory, **found})
    else:
        _print(findings, problems, notes)
    if problems:
        raise typer.Exit(1)


def _print(findings: Sequence[Finding], problems: Sequence[str], notes: Sequence[str]) -> None:
    table = Table("simulator", "version", "renders on", "one frame", box=None, pad_edge=False)
    for finding in findings:
        versions = ", ".join(f"{name} {version}" for name, version in finding.versions.items())
        frame = f"{finding.frame_ms:.0f} ms" if finding.frame_ms else ""
        device = "does not work" if finding.problem else finding.render_device
        device = device if finding.installed else "not installed"
        table.add_row(finding.simulator, versions, device, frame)
    out.print(table)
    for what, where in LISTENS.items():
        print_line(f"listens: {what}: {where}")
    for note in notes:
        print_line(f"note: {note}")
    for problem in problems:
        fail(problem)
    if not problems:
        out.print("everything that is installed works" if notes else "everything works")


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
    places = {".": f"this folder; a run with videos needs up to {MIN_DISK_GB:g} GB"}
    try:
        folder = new_session_folder(LONGEST)
        folder.rmdir()
        places[str(folder.parent)] = f"{folder.parent}, where Ray keeps its files"
    except OSError as error:
        problems.append(f"Ray would not start: {describe_os_error(error)}")
    for place, name in places.items():
        free = shutil.disk_usage(place).free / 1e9
        if free < MIN_DISK_GB:
            problems.append(f"only {free:.1f} GB are free in {name}")
    return problems
