"""A checkpoint of PushT or ALOHA plays here as by `lerobot-eval`: the same successes, rewards and actions by seed."""

import json
import sys
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from robogauntlet.adapters.gymnasium import SIMULATOR
from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.policies import catalog
from robogauntlet.policies.contract import PolicyMismatch, check_tasks
from robogauntlet.results.api import open_run
from robogauntlet.suites.episode import CAMERAS, Episode, Protocol, View
from tests import ROOT
from tests.own_environments import FOLDER
from tests.policies.lerobot.asking import MAKING
from tests.processes import run_gauntlet, run_process

EVALUATING = Path(__file__).with_name("evaluating.py")
COUNT = 3
SUITE = """
name: evaluation
policies: [{{name: act, kind: lerobot, options: {options}}}]
tasks: [gymnasium/{task}]
cameras: [third_person]
seeds: {{start: {start}, count: {count}}}
horizon: {horizon}
success: once
"""
CASES = {
    # The block starts over nine tenths of its outline in the second, and the policy happens to finish it.
    "pusht": ("PushT-v0", 360_145, 60, 96, {"convention": "native"}, [False, True, False], 1e-3),
    "aloha": (
        *("AlohaTransferCube-v0", 1, 40, 640, {"convention": "aloha", "image_size": [480, 640]}),
        *([False] * 3, 1e-4),
    ),
}
"""Environment of LeRobot to task, first seed, horizon, size of images (px), options of the policy, successes, and the
largest difference of an action in its first episode (px; rad, and gripper from 0 to 1).

ALOHA's picture is the middle of a square one, so the rasterizer rounds otherwise: 6 in 100,000 pixels differ.
"""
FEATURES = {"observation.image": {"shape": [3, 96, 96]}, "observation.state": {"shape": [2]}}
ACTIONS = {"action": {"shape": [2]}}


def run(command, cwd, **variables):
    done = run_process(
        command, cwd=cwd, paths=[ROOT], timeout=900, OMP_NUM_THREADS="1", HF_HUB_OFFLINE="1", **variables
    )
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]


def pinned(*names):
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    return [line for line in lines if line.partition("==")[0] in names]


@pytest.fixture(scope="module")
def evaluating(newer, tmp_path_factory):
    """A Python with LeRobot's evaluation, PushT and ALOHA, by its extras, beside what `env create` made."""
    folder = tmp_path_factory.mktemp("evaluating")
    run([newer, "-m", "venv", "--without-pip", folder], folder)
    (site,), (own,) = (
        list(Path(place).glob("lib/python*/site-packages")) for place in (folder, Path(newer).parents[1])
    )
    (site / "lerobot.pth").write_text(str(own))
    python = str(folder / "bin" / "python")
    needed = ["lerobot[evaluation,pusht,aloha]==0.6.1", *pinned("mujoco", "dm_control")]
    run([sys.executable, "-m", "pip", "--python", python, "install", "--quiet", *needed], folder)
    return python


@pytest.mark.nightly
@pytest.mark.simulator
@pytest.mark.ray
@pytest.mark.parametrize("env", CASES)
def test_its_evaluation_and_ours_have_the_same_successes_rewards_and_actions(env, evaluating, newer, tmp_path):
    task, start, horizon, size, more, successes, apart = CASES[env]
    options, file = {"checkpoint": str(tmp_path / "act"), **more}, tmp_path / "actions.npz"
    run([newer, MAKING, tmp_path / "act", f"--{env}"], tmp_path)
    asked = [f"--policy.path={tmp_path / 'act'}", "--policy.device=cpu", f"--env.type={env}", f"--env.task={task}"]
    asked += [f"--env.episode_length={horizon}", f"--seed={start}", f"--eval.n_episodes={COUNT}"]
    asked += ["--eval.batch_size=1", f"--output_dir={tmp_path / 'theirs'}"]
    run([evaluating, EVALUATING, file, *asked], tmp_path, MUJOCO_GL="egl")
    theirs = json.loads((tmp_path / "theirs" / "eval_info.json").read_text())["per_task"][0]["metrics"]
    written = SUITE.format(task=task, start=start, count=COUNT, horizon=horizon, options=json.dumps(options))
    (tmp_path / "suite.yaml").write_text(written)
    command = ["run", "suite.yaml", "--out", "ours", "--no-media"]
    done = run_gauntlet(*command, cwd=tmp_path, ROBOGAUNTLET_ENVIRONMENTS=FOLDER, OMP_NUM_THREADS="1")
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    rows = open_run(tmp_path / "ours").episodes().sort_values("seed")
    assert list(rows.seed) == [*range(start, start + COUNT)]
    assert list(rows.status == "success") == theirs["successes"] == successes
    assert rows.reward_sum.to_numpy() == pytest.approx(theirs["sum_rewards"], abs=1e-6)
    assert min(theirs["sum_rewards"]) < max(theirs["sum_rewards"])
    episode = Episode("p", "d", f"gymnasium/{task}", start, Protocol(horizon, 10, View(CAMERAS[:1], size)))
    with np.load(file) as kept:
        actions = kept["arr_0"][0]
    np.testing.assert_allclose(actions_of(episode, options, newer), actions, rtol=0, atol=apart)


def actions_of(episode, options, python):
    """What the environment is sent in an episode, (steps, numbers)."""
    sent, simulator = [], SIMULATOR.open(episode.task.partition("/")[2], episode.protocol.view)
    with closing(simulator) as simulation, closing(catalog.load("lerobot", {**options, "python": python})) as policy:
        step, simulation.step = (
            simulation.step,
            lambda action: (step(action), sent.append(simulation._moment.action))[0],
        )
        rollout(simulation, policy, episode)
    return np.stack(sent)


def test_a_checkpoint_of_native_numbers_plays_tasks_of_as_many_alone(bare):
    folder = bare(input_features=FEATURES, output_features=ACTIONS)
    spec = catalog.spec("lerobot", {"checkpoint": str(folder), "convention": "native"})
    assert spec.can_act_in("gymnasium/PushT-v0")
    assert not spec.can_act_in("so101/Stack")
    others = bare(input_features=FEATURES, output_features={"action": {"shape": [3]}})
    spec = catalog.spec("lerobot", {"checkpoint": str(others), "convention": "native"})
    with pytest.raises(PolicyMismatch, match="PushT-v0 accepts 2 numbers per action, the policy produces 3"):
        check_tasks(spec, ["gymnasium/PushT-v0"])
    with pytest.raises(PolicyMismatch, match=r"expected observation\.state of 8 numbers"):
        catalog.spec("lerobot", {"checkpoint": str(folder)})
