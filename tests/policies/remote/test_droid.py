"""Policies for DROID behind openpi's own server: their keys and units, and an oracle's velocities through the wire."""

import numpy as np
import pytest

from robogauntlet.adapters.contract import Moves, Observation
from robogauntlet.adapters.robosuite import SIMULATOR
from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.policies import catalog
from robogauntlet.policies.contract import PolicyError, PolicyMismatch, Query, check_tasks
from robogauntlet.policies.oracles import scripts
from robogauntlet.policies.remote.conversion import decode_chunk
from robogauntlet.policies.remote.server_options import read_options
from robogauntlet.results.record import Status
from robogauntlet.suites.episode import CAMERAS, Episode, Protocol, RenderProfile, View
from tests.errors import one_line_error
from tests.policies.remote.test_openpi_client import their_server

NAME = "Lift@DROID-joint-velocity"
TASK = f"robosuite/{NAME}"
DROID = {"convention": "droid", "identity": "pi05_droid"}
SIZE, LARGEST = 224, 3.0
"""Size of images (px), and velocity of a joint for which DROID's policies answer 1 (rad/s)."""


def episode(horizon=8):
    view = View(CAMERAS, SIZE, RenderProfile.FAST)
    return Episode("p", "p", TASK, 0, Protocol(horizon, 8, view))


class Droid:
    """Answers as pi0-FAST-DROID and pi05_droid do: ten actions, each of seven velocities and a gripper."""

    def __init__(self, rows):
        self.rows, self.seen = rows, []

    def infer(self, observation):
        first = 8 * len(self.seen)
        self.seen.append(observation)
        return {"actions": self.rows[np.minimum(np.arange(first, first + 10), len(self.rows) - 1)]}


def test_openpis_keys_and_units_of_droid_are_sent_and_read(monkeypatch):
    angles, rows = np.linspace(-1.0, 1.0, 7), np.full((10, 8), 0.5)
    rows[:, 7] = np.linspace(0.05, 0.95, 10)
    seen = Observation(dict.fromkeys(CAMERAS, np.ones((SIZE, SIZE, 3), np.uint8)), np.append(angles, 0.5), "lift", True)
    theirs = Droid(rows)
    with their_server(theirs, monkeypatch) as address:
        ours = catalog.load("openpi", {"address": address, **DROID})
        (decision,) = ours.act([Query(episode(), 0, seen)])
        ours.close()
    (sent,) = theirs.seen
    assert sorted(sent) == [
        *("observation/exterior_image_1_left", "observation/gripper_position", "observation/joint_position"),
        *("observation/wrist_image_left", "prompt"),
    ]
    assert sent["observation/wrist_image_left"].shape == (SIZE, SIZE, 3)
    np.testing.assert_array_equal(sent["observation/joint_position"], angles)
    np.testing.assert_array_equal(sent["observation/gripper_position"], [0.75])
    assert decision.actions.shape == (8, 8)
    assert np.allclose(decision.actions[:, :7], 0.5 * LARGEST)
    assert decision.actions[:, 7].tolist() == [-1.0] * 5 + [1.0] * 3


@pytest.mark.simulator
def test_an_oracles_velocities_through_openpis_server_lift_the_cube(monkeypatch):
    horizon = SIMULATOR.tasks[NAME].horizon
    played = episode(horizon)
    simulation, script = SIMULATOR.open(NAME, played.protocol.view), scripts()[TASK]()
    simulation.reset(played.seed)
    rows = []
    for _ in range(horizon // 2):
        rows.append(script(simulation.privileged_state()))
        simulation.step(rows[-1])
    rows = np.array(rows) / ([LARGEST] * 7 + [2.0]) + ([0.0] * 7 + [0.5])
    assert np.abs(rows).max() <= 1.0
    theirs = Droid(rows)
    with their_server(theirs, monkeypatch) as address:
        ours = catalog.load("openpi", {"address": address, **DROID})
        row = rollout(simulation, ours, played)
        ours.close()
    simulation.close()
    assert row.status == Status.SUCCESS
    assert theirs.seen[0]["prompt"] == "lift the red cube off the table"
    assert len(theirs.seen) == -(-row.steps // 8)


def test_other_keys_and_sizes_may_be_given_but_no_other_units():
    given = {"cameras": {"wrist": "wrist"}, "proprioception": None, "image_size": 180, "execute": 4}
    options = read_options({"address": "a:1", **DROID, **given})
    assert (options.cameras, options.proprioception, options.image_size, options.execute) == (*given.values(),)
    assert (options.moves, options.action_dim) == (Moves.VELOCITIES, 8)
    with one_line_error(PolicyError, "expected no joints and no velocity_scale, which convention droid sets"):
        read_options({"address": "a:1", **DROID, "joints": 6, "velocity_scale": 1.0})


def test_policies_of_droid_by_targets_have_the_same_keys():
    options = read_options({"address": "a:1", **DROID, "velocity_scale": None})
    assert (options.moves, options.joints, options.image_size) == (Moves.TARGETS, 7, SIZE)
    rows = np.append(np.linspace(-1.0, 1.0, 7), 1.0)[None].repeat(10, axis=0)
    np.testing.assert_allclose(decode_chunk(options, {"actions": rows}), rows[:8])


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"velocity_scale": 1.0}, "velocity_scale: expected joints, their number, beside it"),
        (
            {"joints": 2, "gripper_open": 0, "gripper_closed": 1, "velocity_scale": [1, 0]},
            r"velocity_scale: expected a number other than 0, or one for each of joints, got \[1.0, 0.0\]",
        ),
    ],
)
def test_scales_of_velocities_that_do_not_fit_are_one_line(options, says):
    with one_line_error(PolicyError, says):
        read_options({"address": "a:1", **options})


@pytest.mark.parametrize(
    ("task", "says"),
    [
        ("robosuite/Lift@DROID-joint-position", "accepts targets of joints, the policy produces velocities of joints"),
        ("robosuite/Lift", "accepts 7 numbers per action, the policy produces 8"),
        ("robosuite/Lift@UR5e-joint-velocity", "accepts 7 numbers per action, the policy produces 8"),
    ],
)
def test_a_policy_for_droid_is_refused_in_other_tasks_before_the_first_step(monkeypatch, task, says):
    with their_server(Droid(np.zeros((10, 8))), monkeypatch) as address:
        ours = catalog.load("openpi", {"address": address, **DROID})
        with one_line_error(PolicyMismatch, f"{task} {says}$"):
            check_tasks(ours.spec, [task])
        ours.close()


def test_an_answer_of_other_numbers_is_one_line(monkeypatch):
    with their_server(Droid(np.zeros((10, 32))), monkeypatch) as address:
        ours = catalog.load("openpi", {"address": address, **DROID})
        seen = Observation(dict.fromkeys(CAMERAS, np.ones((SIZE, SIZE, 3), np.uint8)), np.zeros(8), "lift", True)
        with one_line_error(PolicyMismatch, r"expected 'actions' of shape \(n, 8\).* got \(10, 32\); choose"):
            ours.act([Query(episode(), 0, seen)])
        ours.close()
