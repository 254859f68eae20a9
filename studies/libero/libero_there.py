"""LIBERO here and in vla-evaluation-harness: the same actions in its own class, on hf-libero, step by step.

`python -m studies libero --measure libero_there` plays the zoo's experts here, in LIBERO's environment, and what they
did there: `LIBEROBenchmark` of vla-eval 0.8.0 on hf-libero 0.1.4, in an environment that it makes, from the first
stored states of each expert's tasks and by the harness' rule (success once). Its environment does not draw, since the
actions are given. What is finished in `runs/bench/libero_there` is kept.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from robogauntlet.adapters import catalog
from robogauntlet.adapters.contract import FloatArray, StepOutcome
from robogauntlet.adapters.libero import SIMULATOR
from robogauntlet.adapters.libero.assets import find_assets, package_folder
from robogauntlet.adapters.wrapper import SimulationWrapper
from robogauntlet.orchestrator.environments.environment import Environment, adapter_environment
from robogauntlet.orchestrator.environments.installer import create
from robogauntlet.orchestrator.environments.resolver import worker_environment
from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.policies.catalog import load
from robogauntlet.results.statistics.rates import wilson_interval
from robogauntlet.suites.environments import EnvironmentEntry
from robogauntlet.suites.episode import Episode, Protocol, RenderProfile, SuccessRule, View
from studies.libero.libero_experts import EXPERTS, SUITES, suite_of, tasks_of
from studies.merging.operators import percent
from studies.percent import few
from studies.shared import table_of
from studies.tables import ROOT, WRITTEN, write_episodes

FOLDER = WRITTEN / "libero_there"
THERE = EnvironmentEntry(
    requirements=(*SIMULATOR.requirements, "anyio>=4", "msgpack>=1", "websockets>=13", "lazyregistry>=0.4"),
    without_dependencies=("hf-libero==0.1.4", "robosuite==1.4.0", "bddl==1.0.1", "vla-eval==0.8.0"),
)
EPISODES = few(50, 1)
"""Of each suite: its expert's tasks from stored state 0, then from 1, and so on."""
RENDER = RenderProfile.FAST_2
"""As in the experts' demonstrations. What is drawn decides what they do, and not what their actions do."""
CAUSES = (
    ("", False, 10),
    ("fixtures drawn twice", True, 10),
    *(("objects still moved", True, wait) for wait in range(11, 41)),
)
"""What may differ, whether fixtures are drawn once there, and steps in which objects come to rest there."""
COLUMNS = {
    "suite": "{title}",
    "episodes": "{episodes}",
    "success here": "{here}",
    "success there": "{there}",
    "equal outcomes": "{equal}",
    "equal in every step, to the bit": "{same}",
    "after one cause is taken away": "{cured}",
}


def measure() -> list[dict[str, object]]:
    """A row for each suite; writes the episodes beside the rows."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    here, there = adapter_environment(SIMULATOR, always=True), Environment("libero-there", THERE, "the study")
    assert here is not None
    create(here, print)
    create(there, print)
    variables = os.environ | worker_environment(SIMULATOR)
    variables |= {"PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "src")])}
    for environment in (here, there):
        command = [str(environment.python), "-m", __name__, environment.name]
        subprocess.run(command, check=True, env=variables)
    frame = pd.DataFrame(json.loads(path.read_text()) for path in sorted(FOLDER.glob("*.json")))
    write_episodes("libero_there", frame, ("task", "seed"))
    rows = rows_of(frame)
    table_of(rows, COLUMNS)
    return rows


def episodes() -> Iterator[tuple[str, int]]:
    """Tasks and stored states."""
    tasks = {suite: tasks_of(suite) for suite in SUITES}
    for number in range(EPISODES):
        yield from ((own[number % len(own)], number // len(own)) for own in tasks.values())


def path_of(task: str, seed: int, ending: str) -> Path:
    """The file of an episode."""
    return FOLDER / f"{task.partition('/')[2]}-{seed}.{ending}"


class Recorded(SimulationWrapper):
    """Remembers actions, as LIBERO has them, and states: joint positions and velocities."""

    def reset(self, seed: int) -> None:
        """Start the episode."""
        super().reset(seed)
        self.actions: list[FloatArray] = []
        self.states = [self._state()]

    def step(self, action: FloatArray) -> StepOutcome:
        """Act."""
        spec = self.action_spec
        self.actions.append(np.clip(action, spec.low, spec.high) / spec.high)
        outcome = super().step(action)
        self.states.append(self._state())
        return outcome

    def _state(self) -> FloatArray:
        data: Any = self.simulation.__dict__["_data"]
        return np.concatenate([data.qpos, data.qvel])


def play_here() -> None:
    """Play the experts, or what the folder lacks of it; write actions and states."""
    wanted: dict[str, list[int]] = {}
    for task, seed in episodes():
        if not path_of(task, seed, "npz").exists():
            wanted.setdefault(task, []).append(seed)
    for task, seeds in wanted.items():
        policy = load("mergevla", {"checkpoint": f"{EXPERTS}/libero-{suite_of(task)}"})
        view = View(policy.spec.cameras or (), policy.spec.image_size or 0, RENDER)
        horizon = catalog.task_descriptions()[task].horizon
        protocol = Protocol(horizon, policy.spec.chunk_length, view, success=SuccessRule.ONCE)
        with closing(catalog.open_simulation(task, view)) as simulation:
            recorded = Recorded(simulation)
            for seed in seeds:
                result = rollout(recorded, policy, Episode("experts", "", task, seed, protocol))
                found = {"actions": recorded.actions, "states": recorded.states, "success": result.success_once}
                np.savez_compressed(path_of(task, seed, "npz"), **{name: np.array(one) for name, one in found.items()})
                print(f"here: {task} {seed}: {result.status} after {result.steps} steps", flush=True)


def play_there() -> None:
    """Play the recorded actions in the harness' class, or what the folder lacks of it; write a row for each episode."""
    import_theirs()
    for task, seed in episodes():
        row, recorded = path_of(task, seed, "json"), np.load(path_of(task, seed, "npz"))
        if row.exists():
            continue
        found: dict[str, Any] = {"task": task, "seed": seed, "here": bool(recorded["success"])}
        found |= compared(task, seed, recorded["actions"], recorded["states"])
        row.write_text(json.dumps(found))
        print(f"there: {found}", flush=True)


def import_theirs() -> None:
    """Import hf-libero without its questions and its download."""
    folder, settings = package_folder(), FOLDER / "libero"
    settings.mkdir(exist_ok=True)
    paths = {"benchmark_root": ".", "bddl_files": "bddl_files", "init_states": "init_files", "datasets": "datasets"}
    text = yaml.safe_dump({key: f"{folder}/{value}" for key, value in paths.items()})
    (settings / "config.yaml").write_text(text, encoding="utf-8")
    os.environ["LIBERO_CONFIG_PATH"] = str(settings)
    import libero.libero

    libero.libero._assets_path_cache = str(find_assets().folder)


def without_drawing(*, once: bool) -> type:
    """LIBERO's environment without its renderer.

    Args:
        once: Whether fixtures are drawn for one model, and not for those of all hard resets so far too.
    """
    from libero.libero.envs.env_wrapper import ControlEnv

    class Undrawn(ControlEnv):
        def __init__(self, **given: Any) -> None:
            super().__init__(**given, has_offscreen_renderer=False, use_camera_obs=False)

        def reset(self) -> Any:
            if once:
                self.env.object_property_initializers = []
            return super().reset()

    return Undrawn


def compared(task: str, seed: int, actions: FloatArray, states: FloatArray) -> dict[str, Any]:
    """What the actions do there, and whether every state is that of here; if not, with one cause taken away.

    Args:
        task: LIBERO's task, which is number `N` of its suite: `libero/<suite>-<N>-...`.
        seed: The stored state, and the seed of the fixtures.
        actions: Shape (steps, 7), shares of the controller's largest offset.
        states: Shape (steps + 1, nq + nv), before and after each.
    """
    found: dict[str, Any] = {}
    for cause, once, wait in CAUSES:
        reached, there = played_there(task, seed, actions, once=once, wait=wait)
        same = reached.shape == states.shape and bool((reached == states).all())
        if not cause:
            found = {"there": there, "steps_here": len(actions), "steps_there": len(reached) - 1, "same": same}
            count = min(len(reached), len(states))
            found["apart"] = float(np.abs(reached[:count] - states[:count]).max())
        if same:
            return found | {"cause": cause, "cured": True}
    return found | {"cause": "", "cured": False}


def played_there(task: str, seed: int, actions: FloatArray, *, once: bool, wait: int) -> tuple[FloatArray, bool]:
    """Play actions in the harness' class: the states before and after each step, and whether it is a success there.

    Args:
        task: See `compared`.
        seed: See `compared`.
        actions: See `compared`.
        once: See `without_drawing`.
        wait: Steps in which objects come to rest.
    """
    import anyio
    from libero.libero import envs
    from vla_eval.benchmarks.libero.benchmark import LIBEROBenchmark

    envs.OffScreenRenderEnv = without_drawing(once=once)
    suite = suite_of(task)
    played = LIBEROBenchmark(suite=f"libero_{suite}", env_seed=seed, num_steps_wait=wait)
    number = int(task.partition("/")[2].removeprefix(f"{suite}-").split("-")[0])
    anyio.run(played.start_episode, played.get_tasks()[number] | {"episode_idx": seed})
    data = played._env.sim.data
    states = [np.concatenate([data.qpos, data.qvel])]
    for action in actions:
        result = played.step({"actions": action})
        states.append(np.concatenate([data.qpos, data.qvel]))
        if played.check_done(result):
            break
    done = len(states) > 1 and bool(played.get_step_result(result)["success"])
    played.cleanup()
    return np.array(states), done


def rows_of(frame: pd.DataFrame) -> list[dict[str, object]]:
    """Outcomes here and there by suite. `frame` has a row per episode."""
    frame = frame.assign(suite=frame.task.map(suite_of))
    parts = {title: frame[frame.suite == suite] for suite, title in SUITES.items()} | {"all": frame}
    return [_row(title, part) for title, part in parts.items() if len(part)]


def _row(title: str, part: pd.DataFrame) -> dict[str, object]:
    count = len(part)
    return {
        "title": title,
        "episodes": count,
        **{
            side: percent(part[side].mean(), wilson_interval(int(part[side].sum()), count))
            for side in ("here", "there")
        },
        "equal": f"{int((part.here == part.there).sum())} of {count}",
        "same": f"{int(part.same.sum())} of {count}",
        "cured": f"{int(part.cured.sum())} of {count}",
    }


def main(arguments: Sequence[str]) -> None:
    """Play one side, in its own environment."""
    play_there() if arguments[0] == "libero-there" else play_here()


if __name__ == "__main__":
    main(sys.argv[1:])
