"""Stores of synthetic runs."""

from __future__ import annotations

import random
import time
from pathlib import Path

import imageio_ffmpeg
import numpy as np
from PIL import Image

from robogauntlet.results.api import compare, open_run
from robogauntlet.results.live_status import LiveSimulator, LiveStatus, LiveWorker
from robogauntlet.results.media_paths import picture_path, video_path
from robogauntlet.results.record import outcome_row, rows_hash
from robogauntlet.results.report.comparison import reasons
from robogauntlet.results.run_document import Provenance, RunStatus
from robogauntlet.results.store.run_history import History
from robogauntlet.suites.episode import Cell, Protocol, content_hash
from tests.results.synthetic import document, row, run_folder

DAY = 86_400.0
TASKS = ("maniskill/PushCube-v1", "maniskill/StackCube-v1", "pybullet/PandaPush-v3", "robosuite/Lift", "robosuite/Door")
POLICIES = ("experts", "merged", "merged-instruction-hidden")
PROVENANCE = Provenance(
    git_commit="4f1c2a9", git_dirty=False, python="3.11.9", processor="x86_64", cores=8, packages={"robosuite": "1.5.2"}
)


def plan(version=1):
    contents = {policy: content_hash(f"{policy} {version}") for policy in POLICIES}
    return [Cell(policy, contents[policy], task, Protocol(horizon=100)) for task in TASKS for policy in POLICIES]


def nightly_run(root: Path, number: int, started_at: float, *, version=1, rate=0.9, seeds=20):
    """A finished run in a folder, and its document. Each (policy content, task, seed) does the same every night."""
    of = plan(version=version)
    results = []
    for cell in of:
        level = rate - 0.1 * POLICIES.index(cell.policy)
        for seed in range(seeds):
            won = random.Random(f"{version} {cell.policy} {cell.task} {seed}").random() < level
            acts = content_hash([version, cell.policy, seed])
            results.append(row(cell, seed, "success" if won else "failure", actions_hash=acts))
    run = document(
        seeds,
        of=of,
        run_id=content_hash(["nightly", number], length=32),
        rows_hash=rows_hash(map(outcome_row, results)),
        name="nightly",
        suite_text=f"name: nightly\npolicies: [{', '.join(POLICIES)}]\n",
        started_at=started_at,
        finished_at=started_at + 1800,
        elapsed_s=1800.0,
        provenance=PROVENANCE,
    )
    return run_folder(root / f"nightly-{number:03}", run, results), run, results


def record_verdict(history: History, folder: Path, run) -> None:
    """Compare a run with the last good one and record the verdict, as a nightly run does."""
    baseline = history.baseline(run)
    if baseline is not None:
        found = compare(open_run(folder), open_run(baseline.folder))
        history.write_verdict(run.run_id, str(found.verdict), baseline.run_id, reasons(found))


def running(history: History, live: LiveStatus | None = None, *, suite="nightly") -> None:
    """Record the running suite `running-1`, with a live status if one is given."""
    begun = time.time() - 600
    run = document(100, of=plan(), run_id="running-1", name=suite, started_at=begun, status=RunStatus.RUNNING)
    history.record(run, Path("/nowhere/running-1"), counted={})
    if live is not None:
        history.write_live_status("running-1", live)


def live_status(done=120, *, at=None):
    """The live status of a running suite."""
    now = time.time() if at is None else at
    simulators = tuple(
        LiveSimulator(
            simulator=name,
            planned=planned,
            successes=int(share * done),
            failures=done - int(share * done),
            errors=1 if name == "robosuite" else 0,
            per_minute=pace,
        )
        for name, planned, share, pace in (
            ("maniskill", 600, 0.91, 38.0),
            ("pybullet", 300, 0.97, 61.5),
            ("robosuite", 600, 0.84, 24.0),
        )
    )
    busy = (
        ("maniskill-0", "experts on maniskill/StackCube-v1", 4),
        ("pybullet-0", "merged on pybullet/PandaPush-v3", 2),
        ("robosuite-0", "merged on robosuite/Door", 11),
        ("robosuite-1", "starting", 31),
    )
    workers = tuple(
        LiveWorker(worker=name, simulator=name.partition("-")[0], activity=activity, since=now - seconds)
        for name, activity, seconds in busy
    )
    lines = ("maniskill: 2 workers", "robosuite/Door: worker robosuite-1 died (signal 9), its episodes go back")
    return LiveStatus(
        at=now, phase="playing", simulators=simulators, left_s=(400.0, 700.0), workers=workers, messages=lines
    )


def add_videos(folder: Path, run, results) -> None:
    """Videos of the first three failures, and a picture of each task."""
    failed = [one for one in results if one.status == "failure"][:3]
    for number, one in enumerate(failed):
        path = video_path(folder, one.episode_id)
        path.parent.mkdir(parents=True, exist_ok=True)
        writer = imageio_ffmpeg.write_frames(str(path), (128, 128), fps=10, macro_block_size=1)
        writer.send(None)
        for step in range(6):
            frame = np.full((128, 128, 3), 40 + 20 * number, np.uint8)
            frame[40 + 8 * step : 60 + 8 * step, 30:60] = (220, 90, 60)
            writer.send(frame.tobytes())
        writer.close()
    for task in {cell.task for cell in run.plan}:
        path = picture_path(folder, task)
        path.parent.mkdir(parents=True, exist_ok=True)
        shade = 60 + 30 * (len(task) % 5)
        Image.new("RGB", (128, 128), (shade, 110, 190 - shade)).save(path)
