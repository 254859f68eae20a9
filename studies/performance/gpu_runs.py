"""Runs on a machine with a GPU, which also draws: where policies compute, and what that changes in the episodes."""

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
import yaml

from robogauntlet.results.api import open_run
from robogauntlet.results.run_document import read_run
from studies.shared import require_gpu, run_suite, table_of
from studies.tables import episodes_of, write_episodes

TASKS = ("robosuite/Lift", "robosuite/Stack")
SEEDS = 25
PLACES: dict[str, tuple[str, dict[str, Any]]] = {
    "core": ("a core of each worker", {"device": "cpu"}),
    "gpu": ("the GPU, from each worker", {"device": "cuda"}),
    "served": ("the GPU, from a process for all workers", {"device": "cuda"}),
}
POLICIES: dict[str, dict[str, Any]] = {
    "experts": {"kind": "mergevla-experts", "options": {"folder": "zoo:experts"}},
    "merged": {"kind": "mergevla-merged", "options": {"checkpoint": "zoo:merged"}},
}
EPISODE = ["simulator", "task", "policy", "seed", "status", "steps", "state_hash", "actions_hash", "inferred_task"]
TIMES = ["query_p50_s", "inference_s", "render_s", "physics_s", "wall_s", "queries"]
COLUMNS = {
    "policies compute on": "{place}",
    "successes": "{successes} of {episodes}",
    "same outcome as on a core": "{same} of {episodes}",
    "same first state": "{states} of {episodes}",
    "an answer (median)": "{answer_ms:.1f} ms",
    "frames of an episode (mean)": "{frames_s:.2f} s",
}


def measure() -> list[dict[str, Any]]:
    """A row per place; writes the episodes beside the rows."""
    require_gpu()
    frames, rows = [], []
    for name, (title, options) in PLACES.items():
        with tempfile.TemporaryDirectory() as folder:
            suite, run = Path(folder) / "gpu.yaml", Path(folder) / "run"
            suite.write_text(yaml.safe_dump(plan(name, options)), encoding="utf-8")
            run_suite(suite, run)
            print(name, read_run(run).render_devices, flush=True)
            frame = open_run(run).episodes([*EPISODE, *TIMES])
        frames.append(frame.assign(place=name))
        rows.append({"place": title, **compared(frame, frames[0])})
    write_episodes("gpu_runs", pd.concat(frames), ["place", "policy", "task", "seed"])
    table_of(rows, COLUMNS)
    return rows


def counted(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The rows again, from the kept episodes."""
    played = episodes_of("performance", "gpu_runs")
    frames = [played[played.place == place] for place in PLACES]
    return [dict(row) | compared(frame, frames[0]) for row, frame in zip(rows, frames, strict=True)]


def plan(name: str, options: dict[str, Any]) -> dict[str, Any]:
    """The suite of a place."""
    policies = [
        {"name": policy, **kind, "options": {**kind["options"], **options}} for policy, kind in POLICIES.items()
    ]
    inference = {"place": "served", "num_gpus": 1} if name == "served" else {"place": "worker"}
    return {
        "name": f"gpu-{name}",
        "policies": policies,
        "tasks": list(TASKS),
        "seeds": {"count": SEEDS},
        "inference": inference,
    }


def compared(frame: pd.DataFrame, core: pd.DataFrame) -> dict[str, Any]:
    """The figures of a row: outcomes, those equal to a core's, and times."""
    key = ["policy", "task", "seed"]
    both = frame.merge(core, on=key, suffixes=("", "_core"))
    return {
        "episodes": len(frame),
        "successes": int((frame.status == "success").sum()),
        "same": int((both.status == both.status_core).sum()),
        "states": int((both.state_hash == both.state_hash_core).sum()),
        "answer_ms": 1000 * float(frame.query_p50_s.median()),
        "frames_s": float(frame.render_s.mean()),
    }
