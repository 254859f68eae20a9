"""Mappings of gymnasium environments: what they say reaches the environment, on gymnasium's own Reacher."""

import os
import re
import subprocess
import sys
import tomllib
from contextlib import ExitStack, closing
from typing import ClassVar

import numpy as np
import pytest

from robogauntlet.adapters.body import NO_METRES
from robogauntlet.adapters.contract import ActionSpec, TaskUnavailable, UnsupportedCondition
from robogauntlet.adapters.gymnasium import SIMULATOR, Base, EnvironmentMapping, declare
from robogauntlet.adapters.mujoco_scene import orbit_camera
from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.orchestrator.registry import why_impossible
from robogauntlet.policies.catalog import load
from robogauntlet.policies.contract import PolicyInput, PolicyMismatch, PolicySpec, check_tasks
from robogauntlet.suites.episode import CAMERAS, Condition, Episode, Perturbation, Protocol, View
from tests import ROOT
from tests.adapters.goals import check_goal
from tests.errors import one_line_error

VIEW = View(CAMERAS[:1], 32)
PAGE = (ROOT / "docs" / "simulators.md").read_text(encoding="utf-8")


class Reacher(EnvironmentMapping):
    """A tip, which torques move."""

    name, env, instruction, horizon = "Mine", "Reacher-v5", "move the tip to the red dot", 50
    action_spec = ActionSpec(0.02, 0.0, 50.0, ("dy", "dz", "rx", "ry", "rz"))
    cameras = CAMERAS
    base = Base((0.1, 0.0, 0.0), yaw=90)

    def observe(self, moment):
        tip = moment.world.data.body("fingertip")
        pose = {"tcp_position": self.base.point(tip.xpos), "tcp_quaternion": self.base.orientation(tip.xmat)}
        return pose | {"finger_positions": np.zeros(2)}

    def action(self, action):
        return np.array([50 * action[0], 0.5 - 0.5 * action[6]])

    def success(self, moment):
        return moment.info["reward_dist"] >= -0.02

    def camera(self, name, moment):
        if name == "wrist":
            return orbit_camera(moment.world.data.body("fingertip").xpos, 0.2, 0, -80)
        return orbit_camera([0, 0, 0], 0.6, 90, -60)


class NoMujoco(Reacher):
    """Ends after three steps."""

    env, cameras = "NoMujoco-v0", CAMERAS[:1]
    make: ClassVar = {"render_mode": "rgb_array", "length": 3}

    def observe(self, moment):
        x = float(np.ravel(moment.observation)[0])
        pose = {"tcp_position": np.array([x, 0.0, 0.0]), "tcp_quaternion": np.array([1.0, 0.0, 0.0, 0.0])}
        return pose | {"finger_positions": np.zeros(2)}

    def action(self, action):
        return action[:1]

    def success(self, moment):
        return moment.reward > 0


@pytest.fixture
def open_mine():
    """Opens an environment by a mapping, with changes of its attributes."""
    import gymnasium

    if "NoMujoco-v0" not in gymnasium.registry:
        gymnasium.register("NoMujoco-v0", "tests.adapters.no_mujoco:NoMujoco")
    with ExitStack() as stack:

        def open_task(mapping=Reacher, view=VIEW, **changes):
            simulator = declare("mine", "Mine", [type("Changed", (mapping,), changes)])
            return stack.enter_context(closing(simulator.open("Mine", view)))

        yield open_task


def test_a_task_is_described_by_its_mapping():
    task = declare("mine", "Mine", [type("OfPackage", (Reacher,), {"env": "package:Reacher-v5"})]).tasks["Mine"]
    assert (task.instruction, task.horizon, task.cameras) == ("move the tip to the red dot", 50, CAMERAS)
    assert (task.modules, task.goal) == (("package",), None)


@pytest.mark.simulator
@pytest.mark.parametrize("task", [name for name, task in SIMULATOR.tasks.items() if task.goal])
def test_success_is_progress_and_idling_is_none_by_the_goal_of_a_shipped_mapping(task):
    pytest.importorskip("gymnasium_robotics")
    with closing(SIMULATOR.open(task, VIEW)) as simulation:
        check_goal(SIMULATOR, task, simulation, seed=1, steps=10)


@pytest.mark.simulator
@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"env": "Reachr-v5"}, r"gymnasium cannot make 'Reachr-v5': .*Did you mean: `Reacher`"),
        ({"env": "no_such_package:Reacher-v5"}, r"gymnasium cannot make 'no_such_package:.*no_such_package"),
        ({"make": {"colour": "red"}}, r"gymnasium cannot make 'Reacher-v5': .*colour"),
    ],
)
def test_a_task_whose_environment_cannot_be_made_is_left_out_with_a_line(open_mine, changes, line):
    with pytest.raises(TaskUnavailable, match=rf"^[^\n]*{line}[^\n]*$"):
        open_mine(**changes)


@pytest.mark.simulator
def test_numbers_reach_the_environment_scaled_and_its_poses_come_back_in_the_base_frame(open_mine, monkeypatch):
    simulation = open_mine()
    given = []
    step = simulation._env.step
    monkeypatch.setattr(simulation._env, "step", lambda action: given.append(action) or step(action))
    simulation.step(np.array([0.03, 9.0, 0.0, 0.0, 0.0, 0.0, 1.0]))
    np.testing.assert_allclose(given, [[1.0, 0.0]])  # of an action within its bounds
    tip, state = simulation._world.data.body("fingertip"), simulation.privileged_state()
    np.testing.assert_allclose(state["tcp_position"], [tip.xpos[1], 0.1 - tip.xpos[0], tip.xpos[2]], atol=1e-9)
    turn = 2 * np.arctan2(state["tcp_quaternion"][2], state["tcp_quaternion"][3])
    yaw = np.arctan2(tip.xmat[3], tip.xmat[0])
    assert np.cos(turn - (yaw - np.pi / 2)) == pytest.approx(1.0)


def test_a_tool_turns_the_frame_of_the_gripper_itself():
    down = Base().orientation(np.eye(3), tool=(180, 0, 0))
    np.testing.assert_allclose(np.abs(down), [1, 0, 0, 0], atol=1e-9)


@pytest.mark.simulator
def test_orbiting_cameras_follow_a_point_and_a_body(open_mine):
    simulation = open_mine(view=View(CAMERAS, 48))
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
    with closing(SIMULATOR.open("FetchReach-v4", VIEW)) as simulation:
        simulation.reset(0)
        first, second = simulation.picture(), simulation.picture()
    assert np.array_equal(first, second)


@pytest.mark.simulator
def test_an_episode_ends_where_the_environment_ends_it_and_is_what_that_says_then(open_mine):
    fails = {"success": lambda self, moment: moment.reward < 0}
    limited = {"make": {"render_mode": "rgb_array", "length": 9, "limit": 3}}
    for changes, status in (({}, "success"), (fails, "failure"), (limited, "failure")):
        simulation = open_mine(NoMujoco, **changes)
        row = rollout(simulation, load("zero", {}), Episode("zero", "zero", "gymnasium/Mine", 0, Protocol(50, 8)))
        assert (row.status, row.steps) == (status, 3)
        simulation.step(np.zeros(7))
        assert (simulation.picture() == 3).all(), "stepped past the end"


def test_a_mujoco_environment_without_a_camera_says_what_to_write():
    with pytest.raises(NotImplementedError, match=r"NoCamera\.camera: name a camera of MuJoCo's model for 'wrist'"):
        type("NoCamera", (Reacher,), {"camera": EnvironmentMapping.camera})().camera("wrist", None)


PLAY = """
import numpy as np
import robogauntlet

environment = robogauntlet.make("fetch/FetchPush-v4")
environment.reset(seed=7)
for _ in range(5):
    _, _, terminated, _, info = environment.step(np.array([0.02, 0, 0, 0, 0, 0, 1]))
print(terminated, info["success"])
"""


@pytest.mark.simulator
def test_the_package_of_the_page_is_found_and_played(tmp_path):
    pytest.importorskip("gymnasium_robotics")
    files = dict(re.findall(r'^```\w+ title="([^"]+)"\n(.*?)^```$', PAGE, re.MULTILINE | re.DOTALL))
    assert set(files) == {"fetch_push.py", "pyproject.toml"}
    project = tomllib.loads(files["pyproject.toml"])["project"]
    ((group, (entry,)),) = ((group, entries.items()) for group, entries in project["entry-points"].items())
    installed = tmp_path / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    installed.mkdir()
    (installed / "METADATA").write_text(f"Name: {project['name']}\nVersion: {project['version']}\n")
    (installed / "entry_points.txt").write_text(f"[{group}]\n{entry[0]} = {entry[1]}\n")
    (tmp_path / "fetch_push.py").write_text(files["fetch_push.py"])
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", PLAY], capture_output=True, text=True, env=environment, check=False)
    assert done.stdout.splitlines()[-1:] == ["False False"], done.stderr


@pytest.fixture
def pusht():
    pytest.importorskip("gym_pusht")
    with closing(SIMULATOR.open("PushT-v0", View(CAMERAS[:1], 48))) as simulation:
        yield simulation


@pytest.mark.simulator
def test_pusht_is_seen_as_the_environments_own_observations_and_moved_in_its_pixels(pusht):
    pusht.reset(7)
    for _ in range(20):
        outcome = pusht.step(np.array([100.0, 400.0]))
    world, seen = pusht._world, pusht.observe()
    np.testing.assert_allclose(seen.proprioception, [100.0, 400.0], atol=1.0)
    np.testing.assert_array_equal(seen.proprioception, world.agent.position)
    np.testing.assert_array_equal(pusht.privileged_state()["still"], [100.0, 400.0])
    world.obs_type, world.observation_width, world.observation_height = "pixels_agent_pos", 48, 48
    np.testing.assert_array_equal(seen.images["third_person"], world.get_obs()["pixels"])
    assert (outcome.reward, outcome.success) == (min(1.0, world._get_coverage() / 0.95), False)


@pytest.mark.simulator
def test_native_numbers_are_played_delayed_and_seen_worse_and_have_no_behaviour_and_no_noise(pusht):
    def play(policy, **condition):
        protocol = Protocol(12, 4, View(CAMERAS[:1], 48))
        conditions = [Perturbation(*one) for one in condition.items()]
        episode = Episode(policy, policy, "gymnasium/PushT-v0", 3, protocol, Condition.of(*conditions))
        return rollout(pusht, load(policy, {}), episode)

    row = play("untrained")
    assert (row.status, row.path_length, row.gripper_openings, row.progress) == ("failure", None, None, None)
    delayed = play("random", **{"action-delay": 5})
    assert delayed.delivered == 400.0
    assert delayed.final_state_hash != play("random").final_state_hash
    assert play("untrained", noise=3).delivered is not None
    assert play("zero").final_state_hash == play("zero", **{"action-delay": 5}).final_state_hash
    with one_line_error(UnsupportedCondition, "action-noise.*an action is of the environment's own numbers"):
        play("random", **{"action-noise": 2})
    assert why_impossible(Condition("action-noise", 2), "gymnasium/PushT-v0") == NO_METRES
    with one_line_error(PolicyMismatch, "PushT-v0 accepts 2 numbers per action, the policy produces 7"):
        check_tasks(PolicySpec(PolicyInput.OBSERVATION, 8), ["gymnasium/PushT-v0"])
    two = PolicySpec(PolicyInput.OBSERVATION, 8, action_dim=2)
    with one_line_error(PolicyMismatch, "PushT-v0 accepts numbers of the environment's own, .* those of a robot"):
        check_tasks(two, ["gymnasium/PushT-v0"])
