"""A checkpoint of PushT plays here as by `lerobot-eval`: the same successes and rewards on the same seeds."""

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

START, COUNT, HORIZON = 360_145, 5, 60
"""Of them, the block starts over nine tenths of its outline in the second, and the policy happens to finish it."""
SUITE = f"""
name: pusht
policies: [{{name: act, kind: lerobot, options: {{checkpoint: act, convention: native}}}}]
tasks: [gymnasium/PushT-v0]
cameras: [third_person]
image_size: 96
seeds: {{start: {START}, count: {COUNT}}}
horizon: {HORIZON}
success: once
"""
FEATURES = {"observation.image": {"shape": [3, 96, 96]}, "observation.state": {"shape": [2]}}
ACTIONS = {"action": {"shape": [2]}}


def run(command, cwd, **variables):
    done = run_process(
        command, cwd=cwd, paths=[ROOT], timeout=900, OMP_NUM_THREADS="1", HF_HUB_OFFLINE="1", **variables
    )
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]


@pytest.fixture(scope="module")
def evaluating(newer, tmp_path_factory):
    """A Python with LeRobot's evaluation and PushT, as its extras install them, beside what `env create` made."""
    folder = tmp_path_factory.mktemp("evaluating")
    run([newer, "-m", "venv", "--without-pip", folder], folder)
    (site,), (own,) = (
        list(Path(place).glob("lib/python*/site-packages")) for place in (folder, Path(newer).parents[1])
    )
    (site / "lerobot.pth").write_text(str(own))
    python = str(folder / "bin" / "python")
    run(
        [sys.executable, "-m", "pip", "--python", python, "install", "--quiet", "lerobot[evaluation,pusht]==0.6.1"],
        folder,
    )
    return python


@pytest.mark.nightly
@pytest.mark.simulator
@pytest.mark.ray
def test_its_evaluation_and_ours_have_the_same_successes_and_rewards(evaluating, newer, tmp_path):
    run([newer, MAKING, tmp_path / "act", "--pusht"], tmp_path)
    asked = [f"--policy.path={tmp_path / 'act'}", "--policy.device=cpu", "--env.type=pusht", f"--seed={START}"]
    asked += [f"--env.episode_length={HORIZON}", f"--eval.n_episodes={COUNT}", "--eval.batch_size=1"]
    run([evaluating, "-m", "lerobot.scripts.lerobot_eval", *asked, f"--output_dir={tmp_path / 'theirs'}"], tmp_path)
    theirs = json.loads((tmp_path / "theirs" / "eval_info.json").read_text())["per_task"][0]["metrics"]
    (tmp_path / "pusht.yaml").write_text(SUITE)
    command = ["run", "pusht.yaml", "--out", "ours", "--no-media"]
    done = run_gauntlet(*command, cwd=tmp_path, ROBOGAUNTLET_ENVIRONMENTS=FOLDER, OMP_NUM_THREADS="1")
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    rows = open_run(tmp_path / "ours").episodes().sort_values("seed")
    assert list(rows.seed) == [*range(START, START + COUNT)]
    assert list(rows.status == "success") == theirs["successes"]
    assert sorted(set(theirs["successes"])) == [False, True]
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
