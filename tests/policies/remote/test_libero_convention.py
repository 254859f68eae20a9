"""The convention of policies that were trained on LIBERO's own data."""

from dataclasses import replace

import numpy as np
import pytest

from robogauntlet.adapters.contract import Observation
from robogauntlet.adapters.libero.tasks import libero_tasks
from robogauntlet.adapters.libero_plus import SIMULATOR as LIBERO_PLUS
from robogauntlet.policies.contract import PolicyError, PolicyMismatch
from robogauntlet.policies.remote.conversion import decode_chunk, encode_observation
from robogauntlet.policies.remote.libero import BASES, base_of
from robogauntlet.policies.remote.server_options import read_options
from robogauntlet.suites.episode import Episode, Protocol, ProtocolName


def episode(task, name=ProtocolName.ROBOGAUNTLET):
    return Episode("policy", "digest", task, 0, Protocol(10, name=name))


CARD = {"address": "a:1", "convention": "libero"}
SEEN = Observation(
    {name: np.random.default_rng(0).integers(0, 256, (8, 8, 3), dtype=np.uint8) for name in ("third_person", "wrist")},
    np.array([0.4, 0.1, 0.2, 3.1, 0.1, 0.0, 0.03, 0.02]),
    "turn on the stove",
)


def test_images_are_turned_by_half_a_turn_and_the_pose_is_in_the_world_frame():
    message = encode_observation(read_options(CARD), SEEN, episode("libero/goal-7-turn-on-stove"))
    as_libero_draws = SEEN.images["wrist"][::-1]
    np.testing.assert_array_equal(message["observation/wrist_image"], np.rot90(as_libero_draws, 2))
    np.testing.assert_allclose(message["observation/state"], [-0.26, 0.1, 1.112, 3.1, 0.1, 0.0, 0.03, -0.02])


def test_images_that_the_protocol_has_mirrored_are_not_mirrored_again():
    mirrored = replace(SEEN, images={name: image[:, ::-1] for name, image in SEEN.images.items()})
    task = "libero/goal-7-turn-on-stove"
    usual = encode_observation(read_options(CARD), SEEN, episode(task))
    openvla = encode_observation(read_options(CARD), mirrored, episode(task, ProtocolName.OPENVLA))
    for name in ("observation/image", "observation/wrist_image"):
        np.testing.assert_array_equal(openvla[name], usual[name])


def test_a_turn_of_each_camera_takes_the_place_of_the_conventions():
    """As X-VLA was trained: third-person images turned, wrist images as LIBERO draws them, bottom row first."""
    options = read_options({**CARD, "turn": {"third_person": "left-right", "wrist": "upside-down"}})
    task = "libero/goal-7-turn-on-stove"
    mirrored = replace(SEEN, images={name: image[:, ::-1] for name, image in SEEN.images.items()})
    for seen, protocol in ((SEEN, ProtocolName.ROBOGAUNTLET), (mirrored, ProtocolName.OPENVLA)):
        message = encode_observation(options, seen, episode(task, protocol))
        np.testing.assert_array_equal(message["observation/image"], SEEN.images["third_person"][:, ::-1])
        np.testing.assert_array_equal(message["observation/wrist_image"], SEEN.images["wrist"][::-1])
        np.testing.assert_allclose(message["observation/state"][:3], [-0.26, 0.1, 1.112])


def test_an_answer_is_scaled_by_the_controllers_range_and_the_gripper_is_unchanged():
    chunk = decode_chunk(read_options(CARD), {"actions": np.array([[1.0, 0, 0, 0, 0, -1.0, -1.0]])})
    np.testing.assert_allclose(chunk, [[0.0131, 0, 0, 0, 0, -0.118, -1.0]])


def test_every_task_has_a_base_position():
    arenas = {"kitchen_tabletop": "kitchen", "living_room_tabletop": "livingroom", "study_tabletop": "study"}
    for name, task in libero_tasks().items():
        assert tuple(base_of(f"libero/{name}")) == BASES[arenas.get(task.arena, task.arena)]


def test_a_variant_of_liberoplus_has_the_base_of_its_task():
    assert tuple(base_of("libero-plus/robot-10-5-study1-316")) == BASES["study"]
    assert {tuple(base_of(f"libero-plus/{name}")) for name in LIBERO_PLUS.tasks} == set(BASES.values())


@pytest.mark.parametrize("task", ["robosuite/Lift", "libero/", "libero/10-0-attic1-tidy-up"])
def test_a_task_of_another_simulator_is_refused(task):
    with pytest.raises(PolicyMismatch, match=f"convention libero: expected a task of LIBERO, got {task}"):
        encode_observation(read_options(CARD), SEEN, episode(task))


def test_a_scale_together_with_the_convention_is_refused():
    with pytest.raises(PolicyError, match="expected no translation_scale and no turn, which convention libero sets"):
        read_options({**CARD, "translation_scale": 0.05, "turn": "half"})


def test_the_default_convention_does_not_change_a_policys_digest():
    assert "convention" not in read_options({"address": "a:1"}).declaration()
    assert read_options(CARD).declaration()["convention"] == "libero"
