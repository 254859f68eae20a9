"""Plans, rows and stores of runs that were never played, for the tests of results/."""

from __future__ import annotations

import random
import shutil
import sqlite3
from contextlib import closing
from dataclasses import asdict, replace
from pathlib import Path

import pandas as pd

from robogauntlet.results.analysis import robustness
from robogauntlet.results.analysis.tables import CATEGORIES, COLUMNS, build_tables
from robogauntlet.results.record import EpisodeResult
from robogauntlet.results.run_document import PlannedCell, RunDocument, RunStatus, read_run, store_url, write_run
from robogauntlet.results.run_owner import mark_as_own
from robogauntlet.results.store.episode_store import Store
from robogauntlet.suites.episode import Cell, Condition, Protocol, content_hash
from robogauntlet.suites.schema import Suite

TASKS = ("maniskill/PushCube-v1", "maniskill/PickCube-v1", "pybullet/PandaPush-v3", "robosuite/Lift")
CLEAN = (Condition(),)


def cells(policies=("oracle", "random"), tasks=TASKS, conditions=CLEAN):
    return [
        Cell(policy, content_hash(policy), task, Protocol(horizon=100), condition)
        for task in tasks
        for condition in conditions
        for policy in policies
    ]


def suite(name="synthetic", **changes):
    """A suite with these changes. Its name is not checked, since a database may hold any."""
    values = {"name": "synthetic", "policies": ["oracle"], "tasks": ["maniskill/PushCube-v1"], "seeds": {"count": 10}}
    return Suite.model_validate({**values, **changes}).model_copy(update={"name": name})


def document(planned=10, of=None, **changes):
    """A run document. `changes` are fields of it, or of its suite."""
    plan = tuple(
        PlannedCell(
            **{name: getattr(cell, name) for name in ("simulator", "task", "policy", "policy_digest")},
            **asdict(cell.condition),
            planned=planned,
        )
        for cell in (cells() if of is None else of)
    )
    values = {
        "run_id": "run-1",
        "suite": suite(**{name: changes.pop(name) for name in list(changes) if name not in RunDocument.model_fields}),
        "suite_hash": "0123456789abcdef",
        "suite_text": "name: synthetic\n",
        "suite_path": "suites/synthetic.yaml",
        "started_at": 1_760_000_000.0,
        "elapsed_s": 120.0,
        "status": RunStatus.COMPLETE,
    }
    return RunDocument(**{**values, "plan": plan, **changes})


def row(cell, seed, status="success", **changes):
    if status == "error":
        return EpisodeResult.failed_to_run(
            cell.episode(seed), changes.pop("error", "WorkerDied: signal 9"), **{"worker": "w0", **changes}
        )
    values = {
        "status": status,
        "success_once": status == "success",
        "steps": 40 if status == "success" else 100,
        "queries": 5,
        "clipped_steps": 0,
        "reward_sum": 1.5,
        "state_hash": content_hash([cell.task, seed]),
        "final_state_hash": content_hash([cell.task, seed, "end"]),
        "actions_hash": content_hash([cell.policy, seed]),
        "worker": f"{cell.simulator}-0",
        "started_at": 1_760_000_000.0 + seed,
        "reset_s": 0.25,
        "physics_s": 0.5,
        "render_s": 1.0,
        "inference_s": 0.125,
        "wait_s": 0.125,
        "wall_s": 2.0,
    }
    return EpisodeResult.from_episode(cell.episode(seed), **{**values, **changes})


def rows(of=None, planned=10, errors=0, seed=0):
    """A row per planned episode; the first `errors` of each cell are errors."""
    generator = random.Random(seed)
    made = []
    for cell in cells() if of is None else of:
        for number in range(planned):
            status = "error" if number < errors else generator.choice(["success", "failure"])
            made.append(row(cell, number, status))
    return made


def rows_where(is_success, plan, seeds):
    """A row per cell and seed, a success or a failure by `is_success(cell, seed)`."""
    return [
        row(cell, seed, "success" if is_success(cell, seed) else "failure") for cell in plan for seed in range(seeds)
    ]


def with_behaviour(results, kind=lambda result: "not-reached"):
    """The rows with plausible behaviour; `kind(row)` is the kind of each failure."""
    return [result if result.status == "error" else replace(result, **_behaviour(result, kind)) for result in results]


def _behaviour(result, kind):
    won, generator = result.status == "success", random.Random(f"{result.episode_id}")
    contact = generator.random() < 0.2
    return {
        "path_length": round(generator.gauss(0.45, 0.04) if won else generator.gauss(0.7, 0.1), 4),
        "smoothness": round(generator.gauss(-3.0, 0.3), 3),
        "time_to_success": round(0.05 * result.steps - generator.random(), 3) if won else None,
        "progress": round(generator.uniform(0.9, 1.0) if won else generator.uniform(-0.4, 0.6), 3),
        "gripper_openings": generator.choice([1, 1, 2]),
        "contact_steps": 3 if contact else 0,
        "contact_force": round(generator.uniform(5, 40), 1) if contact else 0.0,
        "joint_limit_steps": 0,
        "workspace_steps": 0 if won else generator.choice([0, 0, 9]),
        "failure": None if won else kind(result),
    }


def run_folder(folder: Path, run: RunDocument, results, *, own=True) -> Path:
    """A run folder; `own`, if this user played it."""
    folder.mkdir(parents=True, exist_ok=True)
    write_run(folder, run)
    if own:
        mark_as_own(folder, run)
    with closing(Store.open(store_url(folder, run), run.run_id)) as store:
        store.add(list(results))
    return folder


def copied_run(source: Path, folder: Path) -> Path:
    """A copy of a run folder that counts as played by this user, as the source does."""
    shutil.copytree(source, folder)
    mark_as_own(folder, read_run(folder))
    return folder


def execute(file: Path, *statements):
    """Executes statements of SQL on a database file."""
    with closing(sqlite3.connect(file)) as connection, connection:
        for statement in statements:
            connection.execute(statement)


def columns_of(results, columns):
    return pd.DataFrame({name: [getattr(result, name) for result in results] for name in columns})


def frame_of(results):
    """The columns of records that tables are made from, as a report reads them."""
    made = columns_of(results, COLUMNS)
    return made.astype(dict.fromkeys(CATEGORIES, "category")) if len(made) else made


def tables_of(run, results):
    return build_tables(run, frame_of(results))


def robustness_of(run, results):
    return robustness.build_robustness(run, columns_of(results, robustness.COLUMNS))
