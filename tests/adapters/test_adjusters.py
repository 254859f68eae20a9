"""What simulations let perturbations adjust: set, read back, seen, and undone by a reset to the bit."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from adapters.adjusting import Dynamics, Form, Light, Prop, Unreachable, unit
from adapters.catalog import find, open_simulation, task_cards
from suites.vocabulary import Condition, RenderProfile, View
from tests.adapters.sampling import tasks_here

pytestmark = pytest.mark.simulator
TASKS = [task for task in tasks_here() if find(task.partition("/")[0]).adjusts]
SEED = 3
SEED_IN_SIGHT = 5
STILL = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0])


@pytest.fixture(scope="module", params=TASKS)
def task(request):
    return request.param


@pytest.fixture(scope="module")
def opened(task):
    simulation = open_simulation(task, View(image_size=64, render_profile=RenderProfile.FAST))
    yield simulation
    simulation.close()


@pytest.fixture
def world(opened):
    """A freshly reset simulation; what a test changes in it must be gone with the next reset."""
    opened.reset(SEED, Condition())
    state_hash, seen, picture = opened.state_hash(), images(opened), opened.picture()
    yield opened
    opened.reset(SEED, Condition())
    assert opened.state_hash() == state_hash
    assert all((images(opened)[camera] == seen[camera]).all() for camera in seen)
    assert (opened.picture() == picture).all()


def adjuster(simulation, task, name):
    found = getattr(simulation.adjusters, name)
    if found is None:
        assert name in task_cards()[task].fixed
        pytest.skip(task_cards()[task].fixed[name])
    return found


def images(simulation):
    return dict(simulation.observe().images)


def linear(image):
    encoded = image.astype(float) / 255
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def changed(before, after, by=8):
    """Share of each camera's pixels that differ."""
    return {
        camera: float((np.abs(before[camera].astype(int) - after[camera]).max(axis=2) > by).mean()) for camera in before
    }


def play(simulation, steps=8):
    """A few steps that close the gripper, and what became of the world."""
    for _ in range(steps):
        simulation.step(np.array([0.01, 0.0, -0.01, 0.0, 0.0, 0.0, 1.0]))
    return simulation.state_hash()


def test_what_is_not_offered_in_a_task_is_given_a_reason_and_what_is_offered_is_declared(opened, task):
    simulator, card = find(task.partition("/")[0]), task_cards()[task]
    assert opened.adjusters.offered() == simulator.adjusts - card.fixed.keys()
    assert card.fixed.keys() <= simulator.adjusts


# Lights


@pytest.mark.parametrize("stops", [-1.0, -3.0])
def test_a_gain_darkens_linear_light_by_as_many_stops(world, task, stops):
    lights = adjuster(world, task, "lights")
    own, before = lights.light(), images(world)
    np.testing.assert_allclose(own.gain, 1.0)
    state_hash = world.state_hash()
    lights.set_light(Light(np.full(3, 2.0**stops), own.direction))
    after = images(world)
    for camera in before:
        lit = (before[camera] != after[camera]).any(axis=2) & ((before[camera] > 60) & (before[camera] < 248)).all(
            axis=2
        )
        assert lit.mean() > 0.15
        ratio = np.log2(linear(after[camera])[lit].mean(axis=1) / linear(before[camera])[lit].mean(axis=1))
        assert np.median(ratio) == pytest.approx(stops, abs=0.15)
    np.testing.assert_allclose(lights.light().gain, 2.0**stops, rtol=1e-3)
    assert world.state_hash() == state_hash


def test_a_gain_per_channel_colours_the_light(world, task):
    lights = adjuster(world, task, "lights")
    before = images(world)["third_person"]
    lights.set_light(Light(np.array([1.0, 0.5, 0.25]), lights.light().direction))
    after = images(world)["third_person"]
    usable = (before[..., 2] != after[..., 2]) & ((before > 60) & (before < 248)).all(axis=2)
    stops = np.median(np.log2(linear(after)[usable] / linear(before)[usable]), axis=0)
    np.testing.assert_allclose(stops, [0.0, -1.0, -2.0], atol=0.2)


def test_a_light_direction_is_read_back_and_changes_the_shading(world, task):
    lights = adjuster(world, task, "lights")
    own, before = lights.light(), images(world)
    assert np.linalg.norm(own.direction) == pytest.approx(1.0)
    assert own.direction[2] > 0.0
    other = unit(np.array([0.8, -0.5, 0.4]))
    lights.set_light(Light(own.gain, other))
    np.testing.assert_allclose(lights.light().direction, other, atol=1e-5)
    assert max(changed(before, images(world), by=4).values()) > 0.05
    lights.set_light(own)
    assert max(changed(before, images(world), by=2).values()) == 0.0


# Objects


def test_things_start_within_their_box(opened, task):
    found = adjuster(opened, task, "objects").placeable()
    positions = {name: [] for name in found}
    for seed in range(12):
        opened.reset(seed, Condition())
        for name in found:
            positions[name].append(opened.privileged_state()[f"{name}_position"][:2])
    for name, box in found.items():
        assert (np.array(positions[name]) >= box.low - 1e-6).all()
        assert (np.array(positions[name]) <= box.high + 1e-6).all()
        spread = np.ptp(positions[name], axis=0)
        assert (spread > 0.4 * (box.high - box.low)).all()


def test_a_thing_is_moved_by_the_offset_and_stays_at_rest(world, task):
    objects = adjuster(world, task, "objects")
    name = next(iter(objects.placeable()))
    world.reset(SEED_IN_SIGHT, Condition())
    before, seen = world.privileged_state(), images(world)
    offset = np.array([0.03, -0.02])
    objects.move(name, offset)
    after = world.privileged_state()
    np.testing.assert_allclose(after[f"{name}_position"] - before[f"{name}_position"], [*offset, 0.0], atol=1e-5)
    np.testing.assert_allclose(after["tcp_position"], before["tcp_position"], atol=1e-9)
    assert max(changed(seen, images(world)).values()) > 0.0
    for _ in range(3):
        world.step(STILL)
    assert world.privileged_state()[f"{name}_position"][:2] == pytest.approx(after[f"{name}_position"][:2], abs=2e-3)


# Arm


def test_the_tool_is_brought_elsewhere_and_held_there(world, task):
    arm = adjuster(world, task, "arm")
    before = world.privileged_state()
    turn = Rotation.from_rotvec([0.1, -0.1, 0.2] if arm.turns else [0.0, 0.0, 0.0])
    position = before["tcp_position"] + np.array([0.03, 0.05, 0.03])
    quaternion = (turn * Rotation.from_quat(before["tcp_quaternion"])).as_quat()
    arm.place_tool(position, quaternion)
    after = world.privileged_state()
    np.testing.assert_allclose(after["tcp_position"], position, atol=1e-3)
    assert (Rotation.from_quat(after["tcp_quaternion"]) * Rotation.from_quat(quaternion).inv()).magnitude() < 0.01
    for name in set(before) - {"tcp_position", "tcp_quaternion"}:
        np.testing.assert_allclose(after[name], before[name], atol=1e-6)
    seen = world.observe().proprioception[:3]
    np.testing.assert_allclose(seen, position, atol=1e-3)
    still = STILL.copy()
    still[[6] if "gripper" in world.action_spec.ignored else []] = 0.0
    for _ in range(20):
        world.step(still)
    assert np.linalg.norm(world.privileged_state()["tcp_position"] - position) < 0.01


def test_a_tool_pose_out_of_reach_is_refused_and_nothing_changes(world, task):
    arm = adjuster(world, task, "arm")
    before, state_hash = world.privileged_state(), world.state_hash()
    above = before.get("door_position", before["tcp_position"])
    ground = world.adjusters.stage.table_height if world.adjusters.stage else 0.0
    for position in ([2.0, 0.0, 0.5], [*above[:2], ground - 0.1]):
        with pytest.raises(Unreachable):
            arm.place_tool(np.array(position), before["tcp_quaternion"])
        assert world.state_hash() == state_hash


# Bodies


def test_mass_and_friction_are_read_back_and_leave_the_state_as_it_is(world, task):
    bodies = adjuster(world, task, "bodies")
    assert bodies.dynamics() == Dynamics(1.0, 1.0)
    state_hash = world.state_hash()
    bodies.set_dynamics(Dynamics(mass=2.0, friction=0.5))
    assert bodies.dynamics().mass == pytest.approx(2.0, rel=1e-5)
    assert bodies.dynamics().friction == pytest.approx(0.5, rel=1e-5)
    assert world.state_hash() == state_hash


def test_after_a_reset_the_own_mass_and_friction_act_again(opened, task):
    bodies = adjuster(opened, task, "bodies")
    opened.reset(SEED, Condition())
    clean = play(opened)
    opened.reset(SEED, Condition())
    bodies.set_dynamics(Dynamics(mass=5.0, friction=0.3))
    play(opened)
    opened.reset(SEED, Condition())
    assert bodies.dynamics() == Dynamics(1.0, 1.0)
    assert play(opened) == clean


# Stage


def props(simulation):
    height = simulation.adjusters.stage.table_height
    centre = simulation.privileged_state()["tcp_position"]
    return [
        Prop(form, np.array([centre[0] + 0.02, centre[1] + 0.12 * (i - 1), height + 0.02]), 0.04, 0.3, (0.9, 0.1, 0.6))
        for i, form in enumerate(Form)
    ]


def test_props_are_seen_and_cannot_be_touched(world, task):
    stage = adjuster(world, task, "stage")
    before, state_hash = images(world), world.state_hash()
    shown = props(world)
    stage.show(shown)
    assert max(changed(before, images(world)).values()) > 0.005
    np.testing.assert_allclose(stage.shown(), [prop.position for prop in shown], atol=1e-5)
    assert world.state_hash() == state_hash
    with_props = play(world)
    world.reset(SEED, Condition())
    assert len(stage.shown()) == 0
    assert play(world) == with_props


def test_props_replace_those_before(world, task):
    stage = adjuster(world, task, "stage")
    before = images(world)
    stage.show(props(world))
    stage.show(props(world)[:1])
    assert len(stage.shown()) == 1
    stage.show([])
    assert max(changed(before, images(world), by=0).values()) == 0.0


def test_the_table_is_painted_and_keeps_its_light(world, task):
    stage = adjuster(world, task, "stage")
    before, state_hash = images(world), world.state_hash()
    painted = []
    for grey in (255, 0):
        stage.paint_table(np.full((8, 8, 3), grey, np.uint8))
        painted.append(images(world)["third_person"].astype(int))
    table = (painted[0] - painted[1]).min(axis=2) > 40
    assert table.mean() > 0.05
    assert max(changed(before, images(world)).values()) > 0.05
    stage.paint_table(np.tile(np.uint8([200, 60, 20]), (8, 8, 1)))
    red, green, blue = images(world)["third_person"][table].mean(axis=0)
    assert red > green > blue
    assert world.state_hash() == state_hash


def test_a_pattern_on_the_table_is_seen_as_one(world, task):
    stage = adjuster(world, task, "stage")
    squares = np.kron(np.indices((16, 16)).sum(axis=0) % 2, np.ones((4, 4)))
    stage.paint_table(np.repeat((squares * 255).astype(np.uint8)[..., None], 3, axis=2))
    checked = images(world)["third_person"].astype(int).mean(axis=2)
    stage.paint_table(np.full((8, 8, 3), 128, np.uint8))
    plain = images(world)["third_person"].astype(int).mean(axis=2)
    difference = checked - plain
    assert (difference > 20).mean() > 0.02
    assert (difference < -20).mean() > 0.02


def test_table_height_is_where_things_stand(world, task):
    stage = adjuster(world, task, "stage")
    objects = world.adjusters.objects
    heights = [world.privileged_state()[f"{name}_position"][2] for name in objects.placeable()] if objects else []
    if not task.endswith(("PandaReach-v3", "Door")):
        centre = 0.0 if task.startswith("libero/") else 0.02  # Of a bowl, at its foot.
        assert min(heights) - stage.table_height == pytest.approx(centre, abs=0.012)
