"""`robogauntlet check policy`: play short probes of a policy and say what its numbers do."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from robogauntlet.adapters import catalog as simulators
from robogauntlet.orchestrator.cli.common import RUNS, PolicyOptions, out, print_line
from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
from robogauntlet.orchestrator.kit.finding import Finding, Level
from robogauntlet.policies import catalog
from robogauntlet.policies.references import FORMS, read_options, read_reference, with_options
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.support.errors import BadInput
from robogauntlet.support.text import counted

TASK = "pybullet/PandaPickAndPlace-v3"
FIELDS = ("topic", "level", "text", "numbers")
PICTURE = RUNS / "policy-check.png"


def check(
    policy: Annotated[str, typer.Argument(metavar="POLICY", help=f"{FORMS}.")],
    task: Annotated[
        str, typer.Option(help="simulator/task on which it is played, preferably one that it was trained on.")
    ] = TASK,
    option: PolicyOptions = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the first of the two episodes.")] = 0,
    image_size: Annotated[
        int | None,
        typer.Option(min=16, max=1024, help="Height and width of frames (px); by default as the policy asks."),
    ] = None,
    picture: Annotated[Path, typer.Option(help="PNG file to write.")] = PICTURE,
    as_json: Annotated[bool, typer.Option("--json", help="Print the findings as JSON.")] = False,
) -> None:
    """Play short episodes of a policy and say what its numbers do.

    Units, limits and what each number moves; the gripper; the images as the policy gets them, and whether it looks at
    them; state that is kept between episodes; answer times. Exit code 1 if something is definitely wrong.
    """
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # as in workers
    _check_places(task, picture)
    (entry,) = with_options([read_reference(policy)], read_options(option or ()))
    environments = EnvironmentResolver()
    kind, options = entry.kind, environments.options(entry.kind, entry.options)
    playable = catalog.find(kind).tasks
    if playable is not None and task not in playable():
        raise BadInput(f"policy '{policy}' cannot act in '{task}'{did_you_mean(task, playable())}")

    from PIL import Image

    from robogauntlet.orchestrator.episodes.policy_source import PolicySource
    from robogauntlet.orchestrator.kit.policy.check import Probe, check_policy

    began = time.perf_counter()
    probe = Probe(policy, PolicySource(kind, options, catalog.digest(kind, options)), task, seed, image_size)
    with out.status(f"playing {policy} in {task}"):
        results = list(check_policy(probe))
    findings = [result for result in results if isinstance(result, Finding)]
    images = [result for result in results if not isinstance(result, Finding)]
    try:
        for image in images:
            picture.parent.mkdir(parents=True, exist_ok=True)
            Image.fromarray(image).save(picture)
    except OSError as error:
        raise BadInput(f"{picture}: {error.strerror or error}") from None
    _show(findings, str(picture) if images else None, time.perf_counter() - began, as_json)
    if any(finding.level is Level.FAILED for finding in findings):
        raise typer.Exit(1)


def _check_places(task: str, picture: Path) -> None:
    if picture.suffix.lower() != ".png" or picture.is_dir():
        raise BadInput(f"expected a file that ends in .png for --picture, got '{picture}'")
    known = simulators.task_descriptions()
    if task not in known:
        raise BadInput(f"unknown task '{task}'{did_you_mean(task, known)}")


def _show(findings: Sequence[Finding], picture: str | None, seconds: float, as_json: bool) -> None:
    if as_json:
        plain = [{name: getattr(finding, name) for name in FIELDS} for finding in findings]
        print(json.dumps({"findings": plain, "picture": picture}, indent=1))
        return
    width = max(12, *(len(finding.topic) + 1 for finding in findings))
    for finding in findings:
        mark = finding.level.upper() if finding.level is Level.FAILED else finding.level
        print_line(f"{mark:8} {finding.topic:{width}} {finding.text}")
    counts = {level: sum(finding.level is level for finding in findings) for level in (Level.FAILED, Level.WARNING)}
    out.print(
        f"{counted(len(findings), 'finding')} in {seconds:.0f} s: {counts[Level.FAILED]} failed, "
        f"{counted(counts[Level.WARNING], 'warning')}",
        markup=False,
    )
    if picture:
        print_line(f"picture: {picture}")
