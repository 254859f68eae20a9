"""The perturbations under which demonstrations are recorded."""

from collections import Counter
from itertools import combinations

import numpy as np
import pytest

from robogauntlet.orchestrator.demonstrations.recorder import DemonstrationJob
from robogauntlet.orchestrator.demonstrations.variation import Variation
from robogauntlet.orchestrator.episodes.episode_runner import EpisodeRunner
from robogauntlet.orchestrator.episodes.lease import Lease
from robogauntlet.orchestrator.episodes.policy_source import PolicySource
from robogauntlet.suites.axes import EXCLUSIVE
from robogauntlet.suites.episode import Cell, Condition, Protocol, View

TASK = "robosuite/Lift"
VARIED = Variation.read(["camera-orbit@3", "camera-bump", "noise@0.5", "distractors@4"])
DRAWN = [VARIED.condition(TASK, seed) for seed in range(2000)]


def severities(axis):
    return [part.severity for one in DRAWN for part in one.perturbations if part.axis == axis]


def test_each_axis_is_present_in_half_of_the_episodes_up_to_its_severity():
    for axis, highest in (("noise", 0.5), ("distractors", 4)):
        found = severities(axis)
        assert len(found) == pytest.approx(1000, abs=90)
        assert max(found) <= highest
    assert np.mean(severities("noise")) == pytest.approx(0.25, abs=0.02)
    assert min(severities("noise")) >= 0.01


def test_an_axis_of_whole_severities_has_each_as_often():
    counts = Counter(severities("distractors"))
    assert set(counts) == {1, 2, 3, 4}
    assert min(counts.values()) > 0.8 * max(counts.values())


def test_axes_that_do_not_combine_never_meet():
    pairs = {pair for one in DRAWN for pair in combinations(sorted(p.axis for p in one.perturbations), 2)}
    assert not {tuple(sorted(pair[:2])) for pair in EXCLUSIVE} & pairs
    assert severities("camera-bump")
    assert severities("camera-orbit")


def test_a_condition_depends_on_task_and_seed_alone():
    again = Variation.read(["camera-orbit@3", "camera-bump", "noise@0.5", "distractors@4"])
    assert [again.condition(TASK, seed) for seed in (5, 4)] == [DRAWN[5], DRAWN[4]]
    assert [VARIED.condition("robosuite/Stack", seed) for seed in range(20)] != DRAWN[:20]


def test_axes_that_a_task_cannot_have_are_left_out():
    dynamics = Variation.read(["dynamics"])
    assert {dynamics.condition("pybullet/PandaReach-v3", seed) for seed in range(50)} == {Condition()}


@pytest.mark.simulator
def test_the_record_has_the_images_of_the_varied_scene():
    runner = EpisodeRunner({"oracle": PolicySource("oracle")})
    cell = Cell("oracle", "digest", "pybullet/PandaReach-v3", Protocol(20, 1, View(("third_person",), 32)))
    seed = next(s for s in range(99) if Variation.read(["illuminance@4"]).condition(cell.task, s) != Condition())
    hashes = []
    for vary in (None, Variation.read(["illuminance@4"])):
        (played,) = DemonstrationJob(0.1, variation=vary)(runner, Lease(cell, (seed,)))
        assert played.record is not None, played.error
        hashes.append(played.record.content_hash)
    runner.close()
    assert hashes[0] != hashes[1]
