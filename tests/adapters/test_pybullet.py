"""Tests of the PyBullet adapter only; the conformance tests are common to all adapters."""

from contextlib import ExitStack, closing
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.camera_geometry import looking_at
from robogauntlet.adapters.contract import ACTION_NAMES
from robogauntlet.adapters.pybullet import simulation as adapter
from robogauntlet.adapters.pybullet.meshes import arm_to_draw, settled
from robogauntlet.adapters.scene_control import DynamicsFactors, Form, Light, Prop, Unreachable, unit
from robogauntlet.suites.episode import RenderProfile, View

pytestmark = pytest.mark.simulator
PUSH, PICK, REACH = "PandaPush-v3", "PandaPickAndPlace-v3", "PandaReach-v3"


@pytest.fixture
def opened():
    with ExitStack() as stack:
        yield lambda task, **view: stack.enter_context(closing(adapter.open(task, View(**{"image_size": 64, **view}))))


def press(simulation, seed, *, steps=40, adjust=lambda simulation: None, before_step=lambda step: None):
    """Random actions drawn towards the cube, so that there are contacts to remember."""
    simulation.reset(seed)
    adjust(simulation)
    generator = np.random.default_rng(seed)
    for step in range(steps):
        state = simulation.privileged_state()
        before_step(step)
        action = generator.uniform(simulation.action_spec.low, simulation.action_spec.high)
        action[:3] = 0.3 * action[:3] + np.clip(0.5 * (state["cube_position"] - state["tcp_position"]), -0.05, 0.05)
        simulation.step(action)
    return np.concatenate([np.ravel(values) for values in simulation._physical_state().values()])


@pytest.mark.parametrize("task", [PUSH, PICK])
def test_contacts_of_earlier_episodes_have_no_effect_to_the_bit(opened, task):
    simulation = opened(task)
    expected = {seed: press(simulation, seed) for seed in range(5)}
    for seed in reversed(range(5)):
        press(simulation, seed + 50, steps=13)
        assert np.array_equal(press(simulation, seed), expected[seed])
    assert np.array_equal(press(opened(task), 3), expected[3])


def redecorate(simulation):
    """Another light, props at the tool and a painted table."""
    table, height = simulation.scene_controls.table, 0.3
    simulation.scene_controls.lights.set_light(Light(np.array([0.5, 0.2, 1.0]), unit(np.array([0.3, 0.3, 1.0]))))
    table.show([Prop(form, np.array([0.64, 0.0, height / 2]), height, 0.3, (0.9, 0.7, 0.1)) for form in Form])
    table.paint_table(np.arange(192, dtype=np.uint8).reshape(8, 8, 3))
    simulation.observe()


def fail_to_place(simulation):
    tool = simulation.privileged_state()["tcp_quaternion"]
    for position in ([2.0, 0.0, 0.5], [0.6, 0.0, -0.1]):
        with pytest.raises(Unreachable):
            simulation.scene_controls.arm.place_tool(np.array(position), tool)


def place(simulation):
    state = simulation.privileged_state()
    simulation.scene_controls.arm.place_tool(state["tcp_position"] + [0.03, 0.05, 0.03], state["tcp_quaternion"])


def move(simulation):
    for name in simulation.scene_controls.objects.placeable():
        simulation.scene_controls.objects.move(name, np.array([0.03, -0.02]))


def weigh_down(simulation):
    simulation.scene_controls.dynamics.set_dynamics(DynamicsFactors(mass=3.0, friction=0.4))


@pytest.mark.parametrize("adjust", [redecorate, fail_to_place])
def test_rendering_and_refused_changes_do_not_change_physics_to_the_bit(opened, adjust):
    simulation = opened(PICK)
    assert np.array_equal(press(simulation, 1, adjust=adjust), press(simulation, 1))


@pytest.mark.parametrize("adjust", [redecorate, place, move, weigh_down])
def test_adjustments_have_no_effect_after_a_reset_to_the_bit(opened, adjust):
    simulation = opened(PUSH)
    expected = press(simulation, 2)
    adjusted = press(simulation, 3, adjust=adjust)
    assert np.array_equal(press(simulation, 2), expected)
    assert np.array_equal(press(simulation, 3, adjust=adjust), adjusted)
    assert np.array_equal(press(opened(PUSH), 3, adjust=adjust), adjusted)


def test_moving_the_cube_leaves_the_goal_where_it_is(opened):
    simulation = opened(PUSH)
    simulation.reset(0)
    before = simulation.privileged_state()
    simulation.scene_controls.objects.move("cube", np.array([0.03, -0.02]))
    assert np.array_equal(simulation.privileged_state()["goal_position"], before["goal_position"])


def test_a_turned_tool_stays_turned_until_the_next_reset(opened):
    simulation, turns = opened(REACH), []
    simulation.reset(0)
    state = simulation.privileged_state()
    own = Rotation.from_quat(state["tcp_quaternion"])
    simulation.scene_controls.arm.place_tool(state["tcp_position"], (Rotation.from_rotvec([0.3, 0, 0]) * own).as_quat())
    for _ in range(2):
        for _ in range(20):
            simulation.step(np.array([0.01, 0, 0, 0, 0, 0, 0]))
        turns.append((Rotation.from_quat(simulation.privileged_state()["tcp_quaternion"]) * own.inv()).magnitude())
        simulation.reset(0)
    assert turns == pytest.approx([0.3, 0.0], abs=0.02)


def test_a_cube_is_slowed_down_by_the_friction_that_was_asked_for(opened):
    simulation, lost = opened(PUSH), []
    for factor in (0.5, 1.0):
        simulation.reset(0)
        simulation.scene_controls.dynamics.set_dynamics(DynamicsFactors(friction=factor))
        for _ in range(10):
            simulation._step_physics()
        simulation._client.resetBaseVelocity(simulation._bodies["object"], [0.0, 1.0, 0.0])
        for _ in range(20):
            simulation._step_physics()
        lost.append(1.0 - simulation._client.getBaseVelocity(simulation._bodies["object"])[0][1])
    assert lost[0] / lost[1] == pytest.approx(0.5, rel=0.05)


def test_the_first_row_of_a_texture_is_at_the_left_of_the_robot(opened):
    simulation = opened(REACH)
    simulation.reset(0)
    texture = np.zeros((2, 2, 3), dtype=np.uint8)
    texture[0, 1] = 255
    simulation.scene_controls.table.paint_table(texture)
    bright = np.argwhere(simulation.picture()[128:].min(axis=2) > 200)
    assert bright[:, 1].mean() > 128


def test_observing_does_not_change_what_follows(opened):
    simulation = opened(PUSH)

    def observe(step):
        if step % 8 == 0:
            simulation.observe()
            simulation.picture()
            simulation.state_hash()

    unobserved = press(simulation, 2)
    assert np.array_equal(press(simulation, 2, before_step=observe), unobserved)


def with_and_without_culling(simulation, camera):
    images = []
    for simulation.culling in (False, True):
        images.append(simulation.draw(camera, 64))
    return images


@pytest.mark.parametrize(
    ("task", "profile"), [(PICK, RenderProfile.FAST), (PICK, RenderProfile.FAST_2), (PUSH, RenderProfile.STANDARD)]
)
def test_culling_changes_no_pixel_while_the_arm_moves(opened, task, profile):
    simulation = opened(task, render_profile=profile)
    left_out = set()

    def compare(step):
        for camera in ("third_person", "wrist") if step % 12 == 0 else ():
            assert np.array_equal(*with_and_without_culling(simulation, camera))
            left_out.add((camera, len(simulation._culling._left_out)))

    press(simulation, 0, adjust=redecorate, before_step=compare)
    assert max(count for camera, count in left_out if camera == "wrist") >= 6
    assert any(count for camera, count in left_out if camera == "third_person")


def test_culling_changes_no_pixel_of_cameras_anywhere_with_any_lens(opened):
    simulation = opened(PICK)
    generator = np.random.default_rng(0)
    counts = set()
    for seed in range(24):
        if seed % 8 == 0:
            press(simulation, seed, steps=10)
        eye, target = generator.uniform([-0.4, -0.8, 0.0], [1.2, 0.8, 1.2], (2, 3))
        viewpoint = looking_at(eye, target, generator.uniform(0.1, 2.0), np.array([0.0, 0.0, 1.0]))
        camera = ("third_person", "wrist")[seed % 2]
        simulation.scene_controls.cameras.set_viewpoint(camera, viewpoint)
        assert np.array_equal(*with_and_without_culling(simulation, camera))
        counts.add(len(simulation._culling._left_out))
    assert len(counts) > 5


def test_fast_2_draws_an_arm_of_fewer_triangles_that_looks_and_moves_the_same(opened):
    states, images, shapes, bodies = [], [], [], []
    for profile in (RenderProfile.FAST, RenderProfile.FAST_2):
        simulation = opened(PICK, image_size=96, render_profile=profile)
        states.append(press(simulation, 3))
        images.append(simulation.observe().images)
        client, arm = simulation._client, simulation._bodies["panda"]
        shapes.append([(*shape[:4], *shape[5:]) for shape in client.getVisualShapeData(arm)])
        bodies.append([client.getDynamicsInfo(arm, link) for link in range(-1, client.getNumJoints(arm))])
    assert np.array_equal(*states)
    assert shapes[0] == shapes[1]
    assert bodies[0] == bodies[1]
    for camera, largest in (("third_person", 0.02), ("wrist", 0.002)):
        differences = np.abs(images[0][camera].astype(int) - images[1][camera]).max(axis=2)
        assert (differences > 8).mean() < largest
    assert not np.array_equal(images[0]["third_person"], images[1]["third_person"])


def test_a_control_step_is_that_of_panda_gym_to_the_bit(opened):
    ours, theirs = opened(PUSH), opened(PUSH)
    ends = []
    for simulation in (ours, theirs):
        simulation.reset(0)
        if simulation is theirs:
            simulation._step_physics, simulation._sim = simulation._env.sim.step, SimpleNamespace(n_substeps=1)
        for _ in range(5):
            simulation.step(simulation.action_spec.high)
        ends.append(simulation.state_hash())
    assert ends[0] == ends[1]


def test_two_clients_do_not_disturb_each_other(opened):
    first, second = opened(PUSH), opened(PICK)
    expected = press(first, 1)
    first.reset(1)
    press(second, 7)
    assert np.array_equal(press(first, 1), expected)
    third = opened(REACH)
    second.close()
    fourth = opened(REACH)  # may be given the number of the client just closed
    second.close()
    for simulation in (third, fourth):
        simulation.reset(0)
        simulation.step(np.zeros(7))


def test_a_state_gives_the_same_image_however_often_it_was_drawn(opened):
    """In this state two successive images of PyBullet's own meshes differ in one pixel."""
    simulation, generator = opened(REACH, render_profile=RenderProfile.FAST), np.random.default_rng(27)
    simulation.reset(27)
    colour, across = generator.uniform(0.3, 0.7, 3), generator.normal(size=3) * [1.0, 1.0, 0.0]
    simulation.scene_controls.lights.set_light(Light(colour, unit(across + np.array([0.0, 0.0, 1.0]))))
    for _ in range(3):
        simulation.step(generator.uniform(simulation.action_spec.low, simulation.action_spec.high))
    images = [simulation.draw("third_person", 512) for _ in range(4)]
    assert all(np.array_equal(image, images[0]) for image in images)


def normalised(units):
    """As TinyRenderer normalises, in single precision."""
    x, y, z = np.square(units).T
    return units * (np.float32(1.0) / np.sqrt(x + y + z))[:, None]


@given(arrays(np.float32, (20, 3), elements=st.floats(-1.0, 1.0, width=32)))
def test_settled_normals_stay_as_they_are_when_normalised_and_are_those_given(normals):
    normals = normals[np.linalg.norm(normals, axis=1) > 0.01].astype(np.float64)
    units = settled(normals)
    assert np.array_equal(normalised(units), units)
    np.testing.assert_allclose(units, normals / np.linalg.norm(normals, axis=1, keepdims=True), atol=2e-7)


@pytest.mark.parametrize("simplify", [False, True])
def test_all_normals_of_the_arm_are_settled(simplify):
    pybullet_data = pytest.importorskip("pybullet_data")
    with arm_to_draw(simplify=simplify):
        files = list(Path(pybullet_data.getDataPath()).glob("franka_panda/meshes/*/*.obj"))
        texts = [file.read_text() for file in files]
    assert len(files) > 10
    for text in texts:
        units = np.array([line.split()[1:] for line in text.splitlines() if line.startswith("vn ")], dtype=np.float32)
        assert len(units)
        assert np.array_equal(normalised(units), units)


def test_the_light_of_one_image_does_not_change_the_next(opened):
    simulation = opened(PUSH, cameras=("third_person",))
    simulation.reset(0)
    before = simulation.picture()
    client = simulation._client
    client.getCameraImage(32, 32, lightColor=(0.2, 0, 0), lightAmbientCoeff=0.1, lightDirection=(1, 0, 0), shadow=0)
    assert np.array_equal(simulation.picture(), before)


def test_the_goal_is_red_and_the_cube_is_green(opened):
    simulation = opened(PUSH, cameras=("third_person",), image_size=96)
    simulation.reset(0)
    red, green, blue = np.moveaxis(simulation.observe().images["third_person"].astype(int), -1, 0)
    assert ((red > 2 * green) & (red > 2 * blue)).sum() > 20
    assert ((green > 2 * red) & (green > 2 * blue)).sum() > 20


def test_the_fast_profile_differs_by_its_shadows_only(opened):
    images = []
    for profile in (RenderProfile.STANDARD, RenderProfile.FAST):
        simulation = opened(PUSH, cameras=("third_person",), image_size=128, render_profile=profile)
        simulation.reset(0)
        images.append(simulation.observe().images["third_person"].astype(int))
    brighter = images[1] - images[0]
    assert brighter.min() >= 0
    assert 0.02 < (brighter.max(axis=-1) > 0).mean() < 0.6


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [-1, 1])
def test_a_translation_moves_the_tool_along_its_axis(opened, axis, sign):
    simulation = opened(PICK)
    simulation.reset(0)
    action = np.zeros(7)
    action[axis] = sign * 0.02
    start = simulation.privileged_state()["tcp_position"]
    for _ in range(4):
        simulation.step(action)
    for _ in range(6):
        simulation.step(np.zeros(7))
    moved = simulation.privileged_state()["tcp_position"] - start
    assert 0.8 * 0.08 < sign * moved[axis] < 1.2 * 0.08
    assert np.abs(np.delete(moved, axis)).max() < 0.1 * abs(moved[axis])


def test_the_gripper_goes_to_the_commanded_width(opened):
    simulation = opened(PICK)
    simulation.reset(0)
    for command, width in ((-1.0, 0.08), (0.0, 0.04), (1.0, 0.0)):
        for _ in range(10):
            simulation.step(np.array([0, 0, 0, 0, 0, 0, command]))
        assert simulation.observe().proprioception[6:].sum() == pytest.approx(width, abs=0.003)


@pytest.mark.parametrize("task", [REACH, PUSH, PICK])
def test_ignored_numbers_have_no_effect(opened, task):
    simulation = opened(task)
    ends = []
    for value in (0.0, 1.0):
        simulation.reset(1)
        for _ in range(5):
            action = np.array([0.01, 0.02, -0.01, 0, 0, 0, 0.5])
            for name in simulation.action_spec.ignored:
                action[ACTION_NAMES.index(name)] = value
            simulation.step(action)
        ends.append(simulation.state_hash())
    assert ends[0] == ends[1]
    assert ("gripper" in simulation.action_spec.ignored) == (task != PICK)


def test_success_does_not_end_the_simulation(opened):
    simulation = opened(REACH)
    simulation.reset(0)
    outcomes = []
    for _ in range(25):
        state = simulation.privileged_state()
        action = np.zeros(7)
        action[:3] = 0.7 * (state["goal_position"] - state["tcp_position"])
        outcomes.append(simulation.step(np.clip(action, simulation.action_spec.low, simulation.action_spec.high)))
    assert [o.success for o in outcomes[-5:]] == [True] * 5
    assert not any(o.terminated for o in outcomes)
    assert outcomes[0].reward == -1.0
    assert outcomes[-1].reward == 0.0


def test_opening_prints_nothing_to_standard_output(opened, capfd):
    opened(REACH)
    assert capfd.readouterr().out == ""
