"""`robogauntlet.evaluate`: policies of the caller's process are played by workers, and their runs are tables."""

import os
import warnings

import numpy as np
import pandas as pd
import pytest

import robogauntlet
from robogauntlet.policies import catalog
from robogauntlet.policies.contract import PolicyError
from robogauntlet.support.errors import BadInput
from tests.errors import one_line_error

TASK = "null/Reach"


def drift(images, proprioception, instruction):
    import numpy as np

    return np.full((4, 7), 0.01 + 0.01 * images["wrist"].mean() / 255)


class Accelerating:
    """Acts on the number of its calls in the episode."""

    def __init__(self):
        self.calls = 0

    def reset(self):
        self.calls = 0

    def __call__(self, images, proprioception, instruction):
        self.calls += 1
        return np.full((8, 7), 0.001 * self.calls)


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("ROBOGAUNTLET_HISTORY", raising=False)
    return tmp_path


@pytest.fixture
def play(ray_here):
    def play(policy, seeds=4, **options):
        return robogauntlet.evaluate(policy, TASK, seeds, **{"image_size": 16, "quiet": True, **options})

    return play


@pytest.fixture(scope="module")
def drifted(ray_here, tmp_path_factory):
    """A run of `drift`, clean and with noise."""
    return robogauntlet.evaluate(
        drift, TASK, 4, conditions="noise@2", image_size=16, quiet=True, out=tmp_path_factory.mktemp("drift") / "run"
    )


def actions(run):
    rows = run.episodes()
    return rows[rows["axis"] == "clean"].set_index("seed")["actions_hash"].sort_index().to_dict()


@pytest.mark.ray
def test_a_function_acts_as_the_same_function_in_the_workers(drifted, play, here):
    (here / "drifting.py").write_text(
        "def act(images, proprioception, instruction):\n    import numpy as np\n\n"
        '    return np.full((4, 7), 0.01 + 0.01 * images["wrist"].mean() / 255)\n'
    )
    run = play("python:drifting:act", options={"folder": str(here)})
    assert isinstance(run, robogauntlet.OpenRun)
    assert len(run.episodes()) == 4
    assert actions(run) == actions(drifted)


@pytest.mark.ray
def test_a_run_is_a_table_and_shows_itself(drifted):
    table = drifted.table()
    assert isinstance(table, pd.DataFrame)
    assert table[["policy", "task", "condition", "n"]].values.tolist() == [
        ["drift", TASK, "clean", 4],
        ["drift", TASK, "noise@2", 4],
    ]
    assert "<td>drift</td>" in drifted._repr_html_()


@pytest.mark.ray
def test_runs_of_two_policies_are_compared(drifted, play):
    comparison = drifted.compare("drift", "zero", other=play("zero", conditions="noise@2"))
    assert "drift" in str(comparison)


@pytest.mark.ray
def test_it_stays_in_the_callers_process(play):
    processes = set()

    def act(images, proprioception, instruction):
        processes.add(os.getpid())
        return np.zeros((8, 7))

    play(act)
    assert processes == {os.getpid()}


@pytest.mark.ray
def test_a_policy_of_the_contract_is_the_same_policy_in_any_process(play):
    untrained = catalog.load("untrained", {})
    assert actions(play(untrained)) == actions(play("untrained"))


@pytest.mark.ray
def test_the_state_of_an_object_or_of_its_class_does_not_pass_from_episode_to_episode(play):
    together, alone = play(Accelerating()), play(Accelerating, workers=2)
    assert len(set(actions(together).values())) == 1  # each counts from 1
    assert actions(together) == actions(alone)


@pytest.mark.ray
def test_the_same_function_continues_its_run(drifted, play, capsys):
    run = play(drift, conditions="noise@2", out=drifted.folder, quiet=False)
    assert "continuing: 8 of 8 episodes already done" in capsys.readouterr().out
    assert len(run.episodes()) == 8


@pytest.mark.ray
def test_errors_stop_a_run_with_the_reason(play, caplog):
    def act(images, proprioception, instruction):
        if images["wrist"].any():
            raise KeyError("no such part")
        return np.zeros((1, 7))

    with one_line_error(robogauntlet.EvaluationStopped, "runs/null-Reach-.*the policy raised KeyError: 'no such part'"):
        play(act)


@pytest.mark.ray
def test_simulators_that_are_missing_are_a_warning(play, monkeypatch):
    monkeypatch.setattr("robogauntlet.adapters.catalog.find_spec", lambda module: None)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        robogauntlet.evaluate("zero", [TASK, "pybullet/PandaReach-v3"], 1, quiet=True, image_size=16)
    assert ["pybullet is skipped: not installed" in str(warning.message) for warning in caught].count(True) == 1


def refused(match, policy=drift, tasks=TASK, error=BadInput, **options):
    with one_line_error(error, match):
        robogauntlet.evaluate(policy, tasks, quiet=True, **options)


def test_mistakes_are_one_line_and_nothing_is_started(here):
    refused("unknown task 'null/Rech'; did you mean 'null/Reach'?", tasks="null/Rech")
    refused(r"unknown task 'pybullet/Foo\*'", tasks=["pybullet/Foo*"])
    refused("tasks: expected at least one entry, found an empty list", tasks=[])
    refused("seeds: expected 1 or more, got 0", seeds=0)
    refused(r"seeds: expected their number, such as 20, got range\(0, 3\)", seeds=range(3))
    refused("tasks: expected a task, or a list of them, got None", tasks=None)
    refused("conditions: expected a condition, or a list of them, got 2", conditions=2)
    refused("unknown condition 'noize'; did you mean 'noise'?", conditions=["noize@2"])
    refused("unknown key 'imagesize'; did you mean 'image_size'?", imagesize=32)
    refused("got 'orcale'; did you mean 'oracle'?", policy="orcale")
    refused("policy 'oracle' has no option 'x'", policy="oracle", options={"x": 1})
    refused("identity: expected with a function or object only", policy="oracle", identity="x")
    refused("options: expected with the name of a policy only", options={"x": 1})
    refused(r"policy 'lambda': .*got \(7,\)", lambda images, proprioception, instruction: [0.0] * 7, error=PolicyError)
    refused("expected parameters named images, proprioception", lambda observation: None, error=PolicyError)
    refused("an object with reset plays one episode at a time", Accelerating(), workers=2)
    refused("an object with reset plays one episode at a time", Accelerating(), tasks=[TASK, "pybullet/PandaReach-v3"])
    refused("policy server ws://127.0.0.1:1: ", "openpi://127.0.0.1:1", options={"retries": 0})
    assert list(here.iterdir()) == []
