"""Helpers of the studies: suites are played by the command line."""

import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from robogauntlet.adapters import catalog
from robogauntlet.adapters.contract import FloatArray, Observation, Simulation
from robogauntlet.orchestrator.environments.resolver import worker_environment
from robogauntlet.results.api import open_run
from robogauntlet.results.record import EpisodeResult
from robogauntlet.results.run_document import read_run
from robogauntlet.results.store.episode_store import Store
from robogauntlet.suites.episode import SUCCESS_HOLD, Cell, Episode, Protocol, RenderProfile, View
from studies.percent import IS_PART, few

GAUNTLET = [str(Path(sys.executable).with_name("robogauntlet"))]
"""The command line."""
TASKS = ("maniskill/PushCube-v1", "pybullet/PandaPush-v3", "robosuite/Lift")
"""One task of each simulator."""
FITTED_ROUTERS = ("calibrated", "nearest-centroid", "self-trained")
"""Routers that are fitted to demonstrations; the last one without their tasks, see `routing`."""
UNTRAINED, EXPERTS = "untrained", "mergevla-experts"
POLICY_OPTIONS: dict[str, dict[str, str]] = {UNTRAINED: {}, EXPERTS: {"folder": "zoo:experts"}}
"""The untrained network executes 8 actions per query and never succeeds; experts as many as their metadata say."""
LONGEST = 1000
"""Control steps of the longest task."""
EXPERT_VIEW = View(render_profile=RenderProfile.FAST)


def open_task(task: str, view: View) -> Simulation:
    """Open a task like a worker, with the environment variables of all simulators, as several share the process."""
    for simulator in catalog.simulators().values():
        os.environ.update(worker_environment(simulator))
    return catalog.open_simulation(task, view)


def speed_up(simulation: Any, *, wanted: bool) -> None:
    """Leave out what is outside the view and compile control steps, or draw and step as the simulator by itself."""
    simulation.culling = wanted
    if hasattr(simulation, "_control"):
        simulation._control.exact = wanted


class SteppedTask:
    """A task as evaluation loops commonly have it: every step returns the images."""

    def __init__(self, task: str, view: View) -> None:
        self.simulation = open_task(task, view)
        self.horizon = catalog.task_descriptions()[task].horizon
        self._low, self._high = self.simulation.action_spec.low, self.simulation.action_spec.high
        self.steps = self._held = 0

    @property
    def succeeded(self) -> bool:
        """Whether the task's predicate has held for long enough."""
        return self._held >= SUCCESS_HOLD

    @property
    def timed_out(self) -> bool:
        """Whether the horizon is reached."""
        return self.steps >= self.horizon

    def reset(self, seed: int) -> Observation:
        """Start the seed's episode and observe."""
        self.simulation.reset(seed)
        self.steps = self._held = 0
        return self.simulation.observe()

    def step(self, action: FloatArray) -> tuple[Observation, float]:
        """Step and observe; return the reward too."""
        outcome = self.simulation.step(np.clip(action, self._low, self._high))
        self.steps += 1
        self._held = self._held + 1 if outcome.success else 0
        return self.simulation.observe(), outcome.reward


def episodes(task: str, policy: str, view: View, count: int, *, horizon: int = 40) -> Iterator[Episode]:
    """Episodes of equal length for a policy that never succeeds."""
    cell = Cell(policy, policy, task, Protocol(horizon, 8, view))
    return map(cell.episode, range(count))


def run_suite(suite: str | Path, folder: Path) -> None:
    """Run a suite by the command line, without media; of its seeds and longest episodes the share that is measured.

    Of a share no episode may end in an error. Raises SystemExit with what the command says of a failure.
    """
    plan = yaml.safe_load(Path(suite).read_text(encoding="utf-8"))
    if IS_PART:
        plan["error_tolerance"] = 0.0
        plan["seeds"]["count"] = few(plan["seeds"]["count"])
        plan["horizon"] = min(plan.get("horizon", LONGEST), few(LONGEST))
        suite = folder.with_name(f"{folder.name}.yaml")
        suite.parent.mkdir(parents=True, exist_ok=True)
        suite.write_text(yaml.safe_dump(plan, sort_keys=False), encoding="utf-8")
    command = [*GAUNTLET, "run", str(suite), "--out", str(folder), "--no-media"]
    command += [f"--require={name}" for name in dict.fromkeys(task.partition("/")[0] for task in plan["tasks"])]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(done.stderr)


class Lacking(Exception):
    """What a measurement needs and the machine lacks."""


def require_gpu() -> None:
    """Raise Lacking without a GPU."""
    import torch

    if not torch.cuda.is_available():
        raise Lacking("expected a GPU")


def run_gauntlet(*arguments: object) -> None:
    """Run `robogauntlet ...`; what it prints is shown."""
    subprocess.run([*GAUNTLET, *map(str, arguments)], check=True)


def play_policies(
    folder: Path,
    name: str,
    policies: Mapping[str, Mapping[str, Any]],
    tasks: Sequence[str],
    seeds: int,
    columns: Sequence[str],
    conditions: Sequence[str] = ("clean",),
    first: int = 0,
    **keys: object,
) -> pd.DataFrame:
    """Play policies (name to kind and options) on seeds of tasks from `first` on, or what the folder lacks of it.

    Args: `keys` are further keys of the suite.

    Returns:
        A row per episode with these columns.
    """
    plan = {
        "name": re.sub(r"\W", "-", name.lower()),
        "policies": [{"name": policy, **options} for policy, options in policies.items()],
        "tasks": list(tasks),
        "seeds": {"start": first, "count": seeds},
        "image_size": 96,
        "render_profile": "fast-2",
        "conditions": list(conditions),
        **keys,
    }
    suite, run = folder / "suites" / f"{name}.yaml", folder / "played" / name
    suite.parent.mkdir(parents=True, exist_ok=True)
    suite.write_text(yaml.safe_dump(plan), encoding="utf-8")
    run_suite(suite, run)
    print(f"{name}: played", flush=True)
    return open_run(run).episodes(columns)


def merged_policy(folder: Path | str, router: str = "oracle", **options: object) -> dict[str, Any]:
    """Kind and options of a merged policy for a suite."""
    return {"kind": "mergevla-merged", "options": {"checkpoint": str(folder), "router": router, **options}}


def play_suite(text: str) -> list[EpisodeResult]:
    """Run a suite and return its rows."""
    with tempfile.TemporaryDirectory() as name:
        suite, folder = Path(name) / "suite.yaml", Path(name) / "run"
        suite.write_text(text, encoding="utf-8")
        run_suite(suite, folder)
        return stored_rows(folder)


def stored_rows(folder: Path) -> list[EpisodeResult]:
    """All rows of a run folder."""
    store = Store.open_file(folder / "episodes.sqlite", read_run(folder).run_id)
    rows = list(store.results())
    store.close()
    return rows


def duration_s(rows: Sequence[EpisodeResult]) -> float:
    """Time from the start of the first episode to the end of the last one (s)."""
    return max(row.started_at + row.wall_s for row in rows) - min(row.started_at for row in rows)


def kilobytes(tensors: Mapping[str, Any]) -> float:
    """Size of tensors as they are stored (kB)."""
    return sum(tensor.numel() * tensor.element_size() for tensor in tensors.values()) / 1000


def table(header: tuple[str, ...], rows: list[tuple[object, ...]]) -> None:
    """Print a table with aligned columns."""
    lines = [tuple(map(str, line)) for line in [header, *rows]]
    widths = [max(len(line[i]) for line in lines) for i in range(len(header))]
    for line in lines:
        print("  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip(), flush=True)


COLUMNS: dict[str, str] = {}
"""Those of the latest table."""


def table_of(rows: Sequence[Mapping[str, object]], columns: Mapping[str, str]) -> None:
    """Print rows as a table; each column has a heading and a format with the keys of a row."""
    COLUMNS.clear()
    COLUMNS.update(columns)
    table(tuple(columns), [tuple(text.format(**row) for text in columns.values()) for row in rows])
