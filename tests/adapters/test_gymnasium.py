"""Mapping files: what they may hold, and errors of one line for what does not fit, on gymnasium's own Reacher."""

import os
import subprocess
import sys
from contextlib import ExitStack, closing

import numpy as np
import pytest
import yaml

from robogauntlet.adapters.contract import AdapterError, Goal, TaskUnavailable
from robogauntlet.adapters.gymnasium import SIMULATOR
from robogauntlet.adapters.gymnasium import mapping as mappings
from robogauntlet.adapters.gymnasium import simulation as adapter
from robogauntlet.adapters.gymnasium.expressions import check_expression, value_of
from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.policies.catalog import load
from robogauntlet.suites.episode import CAMERAS, Episode, Protocol, View
from tests.adapters.goals import check_goal

VIEW = View(CAMERAS[:1], 32)
REACHER = {
    "env": "Reacher-v5",
    "instruction": "move the tip to the red dot",
    "horizon": 50,
    "control_hz": 50,
    "max_translation": 0.02,
    "action": {"dx": {"index": 0, "scale": 50}, "gripper": {"index": 1, "scale": -0.5, "offset": 0.5}},
    "base": {"position": [0.1, 0.0, 0.0], "yaw": 90},
    "state": {
        "tcp_position": 'unwrapped.data.body("fingertip").xpos',
        "tcp_quaternion": 'unwrapped.data.body("fingertip").xmat',
        "finger_positions": [0, 0],
        "joints_angles": ["observation[0:2]", 'unwrapped.data.joint("joint0").qpos'],
    },
    "success": 'info["reward_dist"] >= -0.02',
    "cameras": {"third_person": {"at": [0, 0, 0], "distance": 0.6, "azimuth": 90, "elevation": -60}},
}


NO_MUJOCO = {
    "env": "NoMujoco-v0",
    "action": {"dx": {"index": 0, "scale": 1}},
    "state": {"tcp_position": ["observation[0:1]", 0, 0], "tcp_quaternion": [1, 0, 0, 0], "finger_positions": [0, 0]},
}


def write_mapping(folder, changes=None, without=()):
    """A mapping file: that of Reacher with changes at dotted places."""
    data = yaml.safe_load(yaml.safe_dump(REACHER))
    for place, value in (changes or {}).items():
        *path, last = place.split(".")
        inner = data
        for key in path:
            inner = inner[key]
        inner[last] = value
    for key in without:
        del data[key]
    path = folder / "Mine.yaml"
    path.write_text(yaml.safe_dump(data))
    return path


@pytest.fixture
def open_mine(tmp_path, monkeypatch):
    """Opens Reacher by a mapping file with changes."""
    import gymnasium

    if "NoMujoco-v0" not in gymnasium.registry:
        gymnasium.register("NoMujoco-v0", "tests.adapters.no_mujoco:NoMujoco")
    with ExitStack() as stack:

        def open_task(changes=None, view=VIEW):
            monkeypatch.setitem(adapter.FILES, "Mine", write_mapping(tmp_path, changes))
            return stack.enter_context(closing(adapter.open_environment("Mine", view)))

        yield open_task


@pytest.mark.parametrize("path", sorted((mappings.Path(mappings.__file__).parent / "mappings").glob("*.yaml")))
def test_every_shipped_mapping_is_valid(path):
    assert mappings.load_mapping(path)


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"tcp": 1}, "unknown key 'tcp'; known: "),
        ({"instrution": "x"}, "unknown key 'instrution'; did you mean 'instruction'?"),
        ({"action.dx.sacle": 1}, "unknown key 'action.dx.sacle'; did you mean 'scale'?"),
        ({"base.roll": 1}, "unknown key 'base.roll'; known: position, yaw"),
        ({"horizon": 0}, "horizon: should be greater than or equal to 1, found 0"),
        ({"state.tcp_position": "observations[0:3]"}, "unknown name 'observations'; did you mean 'observation'?"),
        ({"state.tcp_position": "observation[0:3"}, "'observation[0:3' is no expression such as observation[0:3]"),
        ({"success": "__import__('os').system('ls')"}, "calls of one argument of: abs, all"),
        ({"success": "unwrapped.__class__"}, "none of which begins with _"),
        ({"success": "[x for x in observation]"}, "only names, [items], numbers"),
        ({"state.tcp_position": "unwrapped.goal"}, "reads 'goal' of the environment; add it to `reads`"),
        ({"reads": ["goal._x"]}, "'goal._x': expected attributes such as robot.position"),
    ],
)
def test_a_mistake_in_a_mapping_is_one_line_with_the_nearest_name(tmp_path, changes, line):
    with pytest.raises(AdapterError) as error:
        mappings.load_mapping(write_mapping(tmp_path, changes))
    assert line in str(error.value)
    assert all(one.startswith(str(tmp_path)) for one in str(error.value).splitlines())


def test_all_mistakes_are_reported_at_once(tmp_path):
    with pytest.raises(AdapterError) as error:
        mappings.load_mapping(write_mapping(tmp_path, {"horizon": "long"}, without=("success",)))
    assert len(str(error.value).splitlines()) == 2
    assert "missing key 'success'" in str(error.value)


@pytest.mark.parametrize("text", ["", "- 1", "a: [", "a: !!python/object:os.x {}"])
def test_a_file_without_a_mapping_is_refused_in_one_line(tmp_path, text):
    path = tmp_path / "Mine.yaml"
    path.write_text(text)
    with pytest.raises(AdapterError, match=rf"^{path}: [^\n]+$"):
        mappings.load_mapping(path)


def test_a_folder_of_ones_own_adds_tasks_and_a_broken_file_affects_no_other(tmp_path):
    write_mapping(tmp_path)
    (tmp_path / "Broken.yaml").write_text("horizon: 3")
    code = (
        "from robogauntlet.adapters.catalog import task_descriptions\n"
        "for name, task in task_descriptions().items(): print(name, task.instruction)"
    )
    environment = {**os.environ, mappings.FOLDERS: str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment)
    assert "gymnasium/Mine move the tip to the red dot" in done.stdout
    assert f"gymnasium/Broken cannot be opened: {tmp_path}/Broken.yaml: missing key 'env'" in done.stdout
    assert "gymnasium/FetchReach-v4" in done.stdout


def test_a_task_has_the_cameras_that_its_mapping_names(tmp_path):
    assert mappings.load_description(write_mapping(tmp_path)).cameras == CAMERAS[:1]
    assert mappings.load_description(write_mapping(tmp_path, {"cameras.wrist": "render"})).cameras == CAMERAS


def test_a_task_has_the_goal_of_its_mapping(tmp_path):
    goal = {"entry": "tcp_position", "offset": [0, 0, 0.1], "axes": "z"}
    assert mappings.load_description(write_mapping(tmp_path, {"goal": goal})).goal == Goal(
        "tcp_position", offset=(0.0, 0.0, 0.1), axes="z"
    )
    assert mappings.load_description(write_mapping(tmp_path)).goal is None


@pytest.mark.simulator
@pytest.mark.parametrize("task", ["FetchReach-v4", "FetchPickAndPlace-v4", "PandaReach-v3"])
def test_success_is_progress_and_idling_is_none_by_the_goal_of_a_shipped_mapping(task):
    pytest.importorskip("gymnasium_robotics")
    with closing(adapter.open_environment(task, VIEW)) as simulation:
        check_goal(SIMULATOR, task, simulation, seed=1, steps=10)


def test_an_expression_only_reads():
    names = {"observation": {"goal": np.arange(5)}, "reward": 0.5}
    assert value_of(check_expression('observation["goal"][1:3]'), names).tolist() == [1, 2]
    assert value_of(check_expression("reward >= -0.5"), names)
    with pytest.raises(ValueError, match=r"KeyError: 'gaol'"):
        value_of('observation["gaol"]', names)


@pytest.mark.simulator
@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"env": "Reachr-v5"}, r"Reachr.*Did you mean: `Reacher`"),
        ({"env": "no_such_package:Reacher-v5"}, "No module named 'no_such_package'"),
        ({"make": {"colour": "red"}}, r"gymnasium cannot make 'Reacher-v5': .*colour"),
        ({"action.dx.index": 2}, "action.dx: expected an index below 2, the size of Reacher-v5's action"),
        (
            {"action.dx.scale": 100},
            "action: number 0 would be -2 to 2, Reacher-v5 takes -1 to 1; lower scale or bounds",
        ),
        ({"state.tcp_position": "observation[0:2]"}, "state.tcp_position: expected 3 numbers, got 2"),
        ({"state.tcp_position": "unwrapped.dat.qpos", "reads": ["dat.qpos"]}, "no 'dat' there; did you mean 'data'?"),
        ({"state.tcp_position": 'unwrapped.data.body("finger").xpos'}, "Invalid name 'finger'"),
        ({"state": {"tcp_position": [0, 0, 0]}}, "state: missing key 'tcp_quaternion'"),
        ({"success": 'info["done"]'}, "KeyError: 'done'"),
        (
            {"goal": {"entry": "finger_positions", "to": "tcp_position"}},
            "goal.to: expected 'tcp_position' to have the shape of 'finger_positions'",
        ),
        (
            {"goal": {"entry": "finger_positions", "offset": [0.1], "axes": "xy"}},
            "goal.axes: expected 'xyz', since 'finger_positions'",
        ),
        ({"cameras.third_person": "front"}, "no camera 'front' in the model"),
        ({"cameras.third_person": "render"}, "Reacher-v5 is of MuJoCo, name one of its cameras or an orbit"),
    ],
)
def test_a_mapping_that_does_not_fit_its_environment_is_left_out_with_a_line(open_mine, changes, line):
    with pytest.raises(TaskUnavailable, match=rf"^[^\n]*{line}[^\n]*$"):
        open_mine(changes)


@pytest.mark.simulator
def test_an_environment_that_cannot_render_is_refused_if_it_must(open_mine):
    changes = {**NO_MUJOCO, "success": "terminated"}
    with pytest.raises(AdapterError, match=r"cameras\.third_person: NoMujoco-v0 cannot render to rgb_array"):
        open_mine({**changes, "cameras": {}})
    with pytest.raises(AdapterError, match="NoMujoco-v0 is not of MuJoCo, only `render` can draw it"):
        open_mine(changes)


@pytest.mark.simulator
def test_numbers_reach_the_environment_scaled_and_its_poses_come_back_in_the_base_frame(open_mine, monkeypatch):
    simulation = open_mine()
    given = []
    step = simulation._env.step
    monkeypatch.setattr(simulation._env, "step", lambda action: given.append(action) or step(action))
    simulation.step(np.array([0.01, 9.0, 0.0, 0.0, 0.0, 0.0, 1.0]))
    np.testing.assert_allclose(given, [[0.5, 0.0]])
    tip, state = simulation._world.data.body("fingertip").xpos, simulation.privileged_state()
    np.testing.assert_allclose(state["tcp_position"], [tip[1], 0.1 - tip[0], tip[2]], atol=1e-9)
    assert state["joints_angles"].size == 3
    assert simulation.action_spec.ignored == ("dy", "dz", "rx", "ry", "rz")


@pytest.mark.simulator
def test_orbiting_cameras_follow_a_point_and_a_body(open_mine):
    wrist = {"at": 'unwrapped.data.body("fingertip").xpos', "distance": 0.2, "azimuth": 0, "elevation": -80}
    simulation = open_mine({"cameras": {**REACHER["cameras"], "wrist": wrist}}, View(CAMERAS, 48))
    simulation.reset(0)
    before = simulation.state_hash()
    images = simulation.observe().images
    assert simulation.state_hash() == before
    assert all((image.shape, image.std() > 5) == ((48, 48, 3), True) for image in images.values())
    for _ in range(10):
        simulation.step(np.array([0.02, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    assert all((image != images[name]).any() for name, image in simulation.observe().images.items())


@pytest.mark.simulator
def test_the_goal_s_marker_stays_in_its_place_from_image_to_image():
    pytest.importorskip("gymnasium_robotics")
    with closing(adapter.open_environment("FetchReach-v4", VIEW)) as simulation:
        simulation.reset(0)
        first, second = simulation.picture(), simulation.picture()
    assert np.array_equal(first, second)


@pytest.mark.simulator
def test_an_episode_ends_where_the_environment_ends_it_and_is_what_that_says_then(open_mine):
    changes = {"make": {"render_mode": "rgb_array", "length": 3}, "cameras": {}}
    for success, makes in (("reward > 0", {}), ("reward < 0", {}), ("reward > 0", {"make.limit": 3, "make.length": 9})):
        simulation = open_mine({**NO_MUJOCO, **changes, "success": success, **makes})
        row = rollout(simulation, load("zero", {}), Episode("zero", "zero", "gymnasium/Mine", 0, Protocol(50, 8)))
        assert (row.status, row.steps) == ("success" if success == "reward > 0" and not makes else "failure", 3)
        simulation.step(np.zeros(7))
        assert (simulation.picture() == 3).all(), "stepped past the end"
