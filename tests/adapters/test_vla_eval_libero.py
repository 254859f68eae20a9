"""The harness's own class of LIBERO, in the environment of LIBERO: its episodes are those of its own runner.

`test_vla_eval_libero.py FOLDER` plays there; the folder has LIBERO's configuration.
"""

import asyncio
import json
import os
import sys
from contextlib import closing

import pytest

from robogauntlet.adapters.vla_eval import Part, declare
from robogauntlet.suites.episode import CAMERAS, View
from tests import ROOT
from tests.own_environments import python_of
from tests.processes import run_process

SENTENCE = "put the bowl on the stove"
ARGUMENTS = {"suite": "libero_goal", "send_wrist_image": True, "send_state": True}
SIMULATOR = declare(
    "there",
    "LIBERO in vla-evaluation-harness",
    "vla_eval.benchmarks.libero.benchmark:LIBEROBenchmark",
    tasks={SENTENCE: SENTENCE},
    action={"position": Part(3, -1.0, 1.0), "rotation": Part(3, -3.15, 3.15), "gripper": Part(1, -1.0, 1.0, -1.0)},
    state={"states": 8},
    cameras={"third_person": "agentview", "wrist": "wrist"},
    horizon=300,
    control_hz=20.0,
    arguments=ARGUMENTS,
    start_states=50,
)
STATE, STEPS = 3, 6


@pytest.mark.nightly
@pytest.mark.simulator
def test_its_episodes_repeat_and_are_those_of_its_own_runner(tmp_path):
    pytest.importorskip("vla_eval")
    command = [python_of("libero"), "-m", "tests.adapters.test_vla_eval_libero", tmp_path]
    done = run_process(command, timeout=600, paths=[ROOT], LIBERO_CONFIG_PATH=str(tmp_path), MUJOCO_GL="egl")
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    found = json.loads(done.stdout.splitlines()[-1])
    assert found == {"same start": True, "same end": True, "same images": True, "again": True, "instruction": SENTENCE}


def play(folder):
    """Print what of an episode is the same here, here again, and by the class itself."""
    import numpy as np
    from vla_eval.benchmarks.libero.benchmark import LIBEROBenchmark

    from robogauntlet.adapters.libero.assets import find_assets, package_folder

    package = package_folder()
    paths = {"bddl_files": package / "bddl_files", "init_states": package / "init_files", "benchmark_root": package}
    paths |= {"assets": find_assets().folder, "datasets": package}
    with open(os.path.join(folder, "config.yaml"), "w") as file:  # noqa: PTH118, PTH123
        file.write("".join(f"{name}: {path}\n" for name, path in paths.items()))
    actions = np.random.default_rng(1).uniform(-1, 1, (STEPS, 7))
    ends = []
    with closing(SIMULATOR.open("put-the-bowl-on-the-stove", View(CAMERAS, 256))) as simulation:
        for _ in range(2):
            simulation.reset(STATE)
            start = simulation.observe()
            for action in actions:
                simulation.step(action)
            ends.append((simulation.observe(), simulation.state_hash()))
    theirs = LIBEROBenchmark(**ARGUMENTS)
    task = next(task for task in theirs.get_tasks() if task["name"] == SENTENCE)
    asyncio.run(theirs.start_episode({**task, "episode_idx": 0}))  # opens it
    np.random.seed(STATE)
    asyncio.run(theirs.start_episode({**task, "episode_idx": STATE}))
    first = asyncio.run(theirs.get_observation())
    for action in actions:
        asyncio.run(theirs.apply_action({"actions": action}))
    last = asyncio.run(theirs.get_observation())
    seen = ends[0][0]
    same = {
        "same start": np.array_equal(start.proprioception, first["states"]),
        "same end": np.array_equal(seen.proprioception, last["states"]),
        "same images": all(
            np.array_equal(seen.images[ours], last["images"][name])
            for ours, name in (("third_person", "agentview"), ("wrist", "wrist"))
        ),
        "again": ends[0][1] == ends[1][1],
        "instruction": seen.instruction,
    }
    print(json.dumps(same))


if __name__ == "__main__":
    play(sys.argv[1])
