"""A checkpoint of PushT or ALOHA plays here as by `lerobot-eval`: the same successes and rewards on the same seeds."""

import json
import sys
from pathlib import Path

import pytest

from robogauntlet.policies import catalog
from robogauntlet.policies.contract import PolicyMismatch, check_tasks
from robogauntlet.results.api import open_run
from tests import ROOT
from tests.own_environments import FOLDER
from tests.policies.lerobot.asking import MAKING
from tests.processes import run_gauntlet, run_process

COUNT = 5
SUITE = """
name: evaluation
policies: [{{name: act, kind: lerobot, options: {{checkpoint: act, {options}}}}}]
tasks: [gymnasium/{task}]
cameras: [third_person]
seeds: {{start: {start}, count: {count}}}
horizon: {horizon}
success: once
"""
CASES = {
    # The block starts over nine tenths of its outline in the second, and the policy happens to finish it.
    "pusht": {"task": "PushT-v0", "start": 360_145, "horizon": 60, "options": "convention: native", "finished": 1},
    "aloha": {
        **{"task": "AlohaTransferCube-v0", "start": 0, "horizon": 40, "finished": 0},
        "options": "convention: aloha, image_size: [480, 640]",
    },
}
"""Environment of LeRobot to what is played here, and the number of successes."""
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
def test_its_evaluation_and_ours_have_the_same_successes_and_rewards(env, evaluating, newer, tmp_path):
    case = CASES[env]
    run([newer, MAKING, tmp_path / "act", f"--{env}"], tmp_path)
    asked = [f"--policy.path={tmp_path / 'act'}", "--policy.device=cpu", f"--env.type={env}", f"--seed={case['start']}"]
    asked += [f"--env.episode_length={case['horizon']}", f"--eval.n_episodes={COUNT}", "--eval.batch_size=1"]
    command = [evaluating, "-m", "lerobot.scripts.lerobot_eval", *asked, f"--output_dir={tmp_path / 'theirs'}"]
    run(command, tmp_path, MUJOCO_GL="egl")
    theirs = json.loads((tmp_path / "theirs" / "eval_info.json").read_text())["per_task"][0]["metrics"]
    (tmp_path / "suite.yaml").write_text(SUITE.format(**case, count=COUNT))
    command = ["run", "suite.yaml", "--out", "ours", "--no-media"]
    done = run_gauntlet(*command, cwd=tmp_path, ROBOGAUNTLET_ENVIRONMENTS=FOLDER, OMP_NUM_THREADS="1")
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    rows = open_run(tmp_path / "ours").episodes().sort_values("seed")
    assert list(rows.seed) == [*range(case["start"], case["start"] + COUNT)]
    assert list(rows.status == "success") == theirs["successes"]
    assert sum(theirs["successes"]) == case["finished"]
    assert rows.reward_sum.to_numpy() == pytest.approx(theirs["sum_rewards"], abs=1e-6)
    assert sum(reward > 0.1 for reward in theirs["sum_rewards"]) >= 3


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
