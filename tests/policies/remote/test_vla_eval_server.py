"""What a server of vla-evaluation-harness' protocol says of a policy and reads of a benchmark: LIBERO's units, ours."""

import io
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image as Picture

from robogauntlet.adapters.contract import Moves, Observation
from robogauntlet.policies.contract import PolicyInput, PolicyMismatch, PolicySpec, Query
from robogauntlet.policies.remote.conversion import decode_chunk, encode_observation
from robogauntlet.policies.remote.server_options import read_options
from robogauntlet.policies.remote.vla_eval import VlaEvalOptions
from robogauntlet.policies.remote.vla_eval_messages import received
from robogauntlet.policies.remote.vla_eval_server import LIBERO, native_action, query_of, specs_of, task_and_convention
from robogauntlet.policies.remote.vla_eval_specs import fitted
from robogauntlet.suites.episode import Episode, Protocol
from tests.errors import one_line_error

OURS = {"convention": "robogauntlet", "gripper_open": -1.0, "gripper_closed": 1.0}
"""The units of a server of ours, whose specs say none."""
SPEC = PolicySpec(PolicyInput.OBSERVATION, 4)
IMAGE = np.arange(32 * 32 * 3, dtype=np.uint8).reshape(32, 32, 3)
SOUND = {"images": {"agentview": IMAGE, "wrist": IMAGE}, "states": np.zeros(8), "task_description": "reach"}
BROKEN = {"__image__": True, "format": "png", "data": b"\x89PNG\r\n\x1a\n rest"}
SPATIAL = {
    "suite": "libero_spatial",
    "task_id": 3,
    "name": "pick up the black bowl on the cookie box and place it on the plate",
}


def compressed(image, form):
    stream = io.BytesIO()
    Picture.fromarray(image).save(stream, form)
    return {"__image__": True, "format": form, "data": stream.getvalue(), "shape": list(image.shape)}


def test_an_image_in_their_compression_is_the_image():
    np.testing.assert_array_equal(received(compressed(IMAGE, "png")), IMAGE)
    assert received(compressed(IMAGE, "jpeg")).shape == IMAGE.shape


def test_libero_gets_its_own_units_and_the_policy_ours():
    """The way back of `encode_observation` and `decode_chunk`, which are the client's in LIBERO's units."""
    task, convention = task_and_convention(SPATIAL, "vla_eval.benchmarks.libero.benchmark:LIBEROBenchmark")
    assert (task, convention) == ("libero/spatial-3-on-cookie-box", LIBERO)
    episode = Episode("p", "d", task, 0, Protocol(220))
    state = np.array([0.4, 0.1, 0.2, 3.0, 0.1, -0.2, 0.02, 0.03])
    shown = Observation({"third_person": IMAGE, "wrist": IMAGE[::-1].copy()}, state, SPATIAL["name"])
    options = read_options({"address": "a:1", "convention": "libero"}, VlaEvalOptions)
    sent = encode_observation(options, shown, episode)
    images = {key: sent.pop(key) for key in ("agentview", "wrist")}
    found = query_of({"images": images, **sent}, episode, 0, SPEC, convention).observation
    assert {name: image.tolist() for name, image in found.images.items()} == {
        name: image.tolist() for name, image in shown.images.items()
    }
    np.testing.assert_allclose(found.proprioception, state, atol=1e-9)
    action = np.array([0.01, -0.005, 0.0, 0.05, 0.0, -0.1, 0.3])
    native = native_action(convention, action)
    np.testing.assert_allclose(decode_chunk(options, {"actions": native[None]})[0], action, atol=1e-15)


def test_their_libero_benchmark_is_read():
    libero = pytest.importorskip("vla_eval.benchmarks.libero.benchmark").LIBEROBenchmark(
        send_wrist_image=True, send_state=True
    )
    controller = SimpleNamespace(ee_pos=np.zeros(3), ee_ori_mat=np.eye(3))
    libero._env = SimpleNamespace(robots=[SimpleNamespace(controller=controller)])
    down = {"robot0_eef_pos": np.array([-0.2, 0.0, 1.1]), "robot0_eef_quat": np.array([-1.0, 0.0, 0.0, 0.0])}
    raw = {"agentview_image": IMAGE, "robot0_eye_in_hand_image": IMAGE, "robot0_gripper_qpos": np.array([0.03, -0.04])}
    task, convention = task_and_convention(SPATIAL, "")
    found = query_of(libero.make_obs(raw | down, SPATIAL), Episode("p", "d", task, 0, Protocol(9)), 0, SPEC, convention)
    np.testing.assert_allclose(found.observation.proprioception, [0.46, 0.0, 0.188, np.pi, 0, 0, 0.03, 0.04], atol=1e-6)
    np.testing.assert_array_equal(found.observation.images["third_person"], IMAGE[::-1])  # theirs are upside down
    assert found.observation.instruction == SPATIAL["name"]


@pytest.mark.parametrize(
    ("suite", "number", "task"),
    [
        ("libero_goal_swap", 1, "libero/goal-1"),
        ("libero_object", None, "libero/object-"),
        ("libero_mem", 1, None),
        ("libero", 1, None),
    ],
)
def test_suites_of_libero_and_its_successors_are_known_by_their_names(suite, number, task):
    assert task_and_convention({"suite": suite, "task_id": number, "name": "x"}, "mine:Toy")[0] == task


def test_a_policy_that_sees_nothing_needs_no_images():
    episode = Episode("p", "d", "a/b", 0, Protocol(9))
    spec = PolicySpec(PolicyInput.NOTHING, 4)
    assert query_of({"images": {"agentview": BROKEN}}, episode, 3, spec, LIBERO) == Query(episode, 3)


def test_images_have_the_size_that_the_policy_was_made_for():
    spec = PolicySpec(PolicyInput.OBSERVATION, 4, image_size=24)
    found = query_of(SOUND, Episode("p", "d", "a/b", 0, Protocol(9)), 0, spec, task_and_convention({}, "")[1])
    assert {image.shape for image in found.observation.images.values()} == {(24, 24, 3)}


def test_velocities_of_joints_have_no_words_in_the_protocol():
    spec = PolicySpec(PolicyInput.OBSERVATION, 4, 8, moves=Moves.VELOCITIES)
    with one_line_error(PolicyMismatch, "expected a policy of tools or targets of joints, got one of velo"):
        specs_of(spec, 8)


@pytest.mark.parametrize(("joints", "numbers"), [(None, 7), (5, 6)])
def test_the_specs_are_those_that_our_client_asks_for(joints, numbers):
    said = specs_of(SPEC, numbers)
    given = OURS | ({"joints": joints} if joints else {})
    options = fitted(read_options({"address": "a:1", **given}, VlaEvalOptions), said)
    assert (options.cameras, options.proprioception) == ({"third_person": "agentview", "wrist": "wrist"}, "state")
    one = specs_of(PolicySpec(PolicyInput.OBSERVATION, 1, cameras=("third_person",)), numbers)
    options = fitted(read_options({"address": "a:1", **given}, VlaEvalOptions), one)
    assert options.cameras == {"third_person": "agentview"}
    assert specs_of(PolicySpec(PolicyInput.NOTHING, 1), numbers).keys() == {"action_spec"}
