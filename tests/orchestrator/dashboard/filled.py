"""Stores of synthetic runs, for tests and for looking at pages."""

from __future__ import annotations

import random
import time
from pathlib import Path

import imageio_ffmpeg
import numpy as np
from PIL import Image

from robogauntlet.orchestrator.schedules.schedule import Schedule, State
from robogauntlet.orchestrator.schedules.store import ScheduleStore
from robogauntlet.results.api import compare, open_run
from robogauntlet.results.live_status import LiveSimulator, LiveStatus, LiveWorker
from robogauntlet.results.media_paths import picture_path, video_path
from robogauntlet.results.report import write_report
from robogauntlet.results.report.comparison import reasons
from robogauntlet.results.run_document import Provenance, RunStatus
from robogauntlet.results.store.database import file_url
from robogauntlet.results.store.history_import import record_run_folder
from robogauntlet.results.store.run_history import History
from robogauntlet.suites.episode import Cell, Protocol, content_hash
from tests.results.synthetic import document, row, run_folder

DAY = 86_400.0
TASKS = ("maniskill/PushCube-v1", "maniskill/StackCube-v1", "pybullet/PandaPush-v3", "robosuite/Lift", "robosuite/Door")
POLICIES = ("experts", "merged", "merged-instruction-hidden")
PROVENANCE = Provenance(
    git_commit="4f1c2a9", git_dirty=False, python="3.11.9", processor="x86_64", cores=8, packages={"robosuite": "1.5.2"}
)


def plan(policies=POLICIES, tasks=TASKS, version=1):
    return [
        Cell(policy, content_hash(f"{policy} {version}"), task, Protocol(horizon=100))
        for task in tasks
        for policy in policies
    ]


def nightly_run(
    root: Path, number: int, started_at: float, *, version=1, rate=0.9, seeds=20, suite="nightly", **changes
):
    """A finished run in a folder, and its document. Each (policy content, task, seed) does the same every night."""
    of = plan(version=version)
    results = []
    for cell in of:
        level = rate - 0.1 * POLICIES.index(cell.policy)
        for seed in range(seeds):
            won = random.Random(f"{version} {cell.policy} {cell.task} {seed}").random() < level
            results.append(row(cell, seed, "success" if won else "failure", actions_hash=content_hash([version, seed])))
    run = document(
        seeds,
        of=of,
        **{
            "run_id": f"{content_hash([suite, number])[:32]}",
            "name": suite,
            "suite_text": f"name: {suite}\npolicies: [{', '.join(POLICIES)}]\n",
            "started_at": started_at,
            "finished_at": started_at + 1800,
            "elapsed_s": 1800.0,
            "provenance": PROVENANCE,
            **changes,
        },
    )
    folder = run_folder(root / f"{suite}-{number:03}", run, results)
    return folder, run, results


def record_verdict(history: History, folder: Path, run) -> None:
    """Compare a run with the last good one and record the verdict, as a nightly run does."""
    baseline = history.baseline(run)
    if baseline is not None:
        found = compare(open_run(folder), open_run(baseline.folder))
        history.write_verdict(run.run_id, str(found.verdict), baseline.run_id, reasons(found))


def running(history: History, run_id="running-1", suite="nightly", **changes):
    """A running suite without a live status; see `live_status`."""
    run = document(
        100,
        of=plan(),
        **{"run_id": run_id, "name": suite, "started_at": time.time() - 600, "status": RunStatus.RUNNING, **changes},
    )
    history.record(run, Path("/nowhere") / run_id, counted={})
    return run


def live_status(done=120, *, at=None, errors=1, workers=True):
    """The live status of a running suite."""
    now = time.time() if at is None else at
    simulators = tuple(
        LiveSimulator(
            simulator=name,
            planned=planned,
            successes=int(share * done),
            failures=done - int(share * done),
            errors=errors if name == "robosuite" else 0,
            per_minute=pace,
            left_s=(planned - done) / pace * 60,
        )
        for name, planned, share, pace in (
            ("maniskill", 600, 0.91, 38.0),
            ("pybullet", 300, 0.97, 61.5),
            ("robosuite", 600, 0.84, 24.0),
        )
    )
    busy = (
        LiveWorker(
            worker="maniskill-0", simulator="maniskill", activity="experts on maniskill/StackCube-v1", since=now - 4
        ),
        LiveWorker(
            worker="pybullet-0", simulator="pybullet", activity="merged on pybullet/PandaPush-v3", since=now - 2
        ),
        LiveWorker(worker="robosuite-0", simulator="robosuite", activity="merged on robosuite/Door", since=now - 11),
        LiveWorker(worker="robosuite-1", simulator="robosuite", activity="starting", since=now - 31),
    )
    lines = ("maniskill: 2 workers", "robosuite/Door: worker robosuite-1 died (signal 9), its episodes go back")
    return LiveStatus(at=now, phase="playing", simulators=simulators, workers=busy if workers else (), messages=lines)


def add_videos(folder: Path, run, results, count=6) -> None:
    """Videos of the first failures, and a picture of each task."""
    failed = [one for one in results if one.status == "failure"][:count]
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


def example_store(root: Path, nights: int = 40) -> tuple[History, ScheduleStore]:
    """Forty nightly runs with two regressions, a running suite, a silent one, and schedules."""
    root.mkdir(parents=True, exist_ok=True)
    history = History.open(file_url(root / "history.sqlite"))
    schedule_store = ScheduleStore.open(history.url)
    now = time.time()
    first = now - (nights - 1) * DAY - now % DAY + 2 * 3600 - DAY
    version, rate = 1, 0.86
    for number in range(nights):
        if number in (12, 27):
            version, rate = version + 1, 0.72
        elif number in (14, 30):
            version, rate = version + 1, 0.9
        changes = {"status": RunStatus.STOPPED, "reason": "the disk was full"} if number == 20 else {}
        folder, run, results = nightly_run(
            root, number, first + number * DAY, version=version, rate=rate, seeds=40, **changes
        )
        record_run_folder(history, folder, run)
        record_verdict(history, folder, run)
        if number == nights - 1:
            add_videos(folder, run, results)
            write_report(folder)
    schedule = Schedule("nightly", "nightly", "0 2 * * *", "Europe/Berlin", created_at=now - 3 * DAY, keep=60)
    schedule_store.add(schedule)
    schedule_store.add(
        Schedule("weekly-screening", "screening", "0 4 * * 6", created_at=now, arguments=("--seeds", "20"))
    )
    schedule_store.record_due(now, lambda one, at: str(root / f"{one.name}-{at:.0f}"))
    states = ((State.DONE, "no evidence of a difference"), (State.FAILED, "stopped early: the disk was full"))
    for number, scheduled_run in enumerate(schedule_store.scheduled_runs()):
        state, outcome = states[number % 2]
        schedule_store.change(
            scheduled_run,
            state=state,
            outcome=outcome,
            began_at=scheduled_run.due_at,
            ended_at=scheduled_run.due_at + 1800,
        )
    running(history, "running-1")
    history.write_live_status("running-1", live_status(140))
    running(history, "running-2", "screening", started_at=now - 7200)
    history.write_live_status("running-2", live_status(80, at=now - 1500, workers=False))
    return history, schedule_store
