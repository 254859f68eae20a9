"""Every axis in the three real simulators: delivered as asked for, and nothing else changed."""

import json

import pytest

from robogauntlet.adapters.catalog import open_simulation
from robogauntlet.orchestrator.episodes.episode_runner import EpisodeRunner
from robogauntlet.orchestrator.episodes.policy_source import PolicySource
from robogauntlet.orchestrator.perturbations import perturbed
from robogauntlet.orchestrator.perturbations.base import PerturbedScene
from robogauntlet.orchestrator.runs.plan import why_unadjusted
from robogauntlet.results.record import Status, outcome_row
from robogauntlet.suites.axes import AXES, Changes
from robogauntlet.suites.episode import Condition, Episode, Protocol, RenderProfile, View

pytestmark = pytest.mark.simulator
TASKS = ("maniskill/PushCube-v1", "pybullet/PandaPush-v3", "robosuite/Lift")
FELT = {Changes.ACTIONS, Changes.OBJECTS, Changes.ARM, Changes.BODIES}
"""What an oracle meets without looking."""
VIEW = View(image_size=96, render_profile=RenderProfile.FAST)


def episode(task, condition, policy):
    return Episode(policy, policy, task, 7, Protocol(24, 8, VIEW), condition)


@pytest.fixture(scope="module", params=TASKS)
def played(request):
    """The record of one short episode under every axis at severities 1 and 5, and of the clean one."""
    runner = EpisodeRunner({name: PolicySource(name) for name in ("untrained", "oracle")})
    able = [axis for axis in AXES.values() if not why_unadjusted(axis, request.param)]
    conditions = [Condition(), *(Condition(axis.name, s) for axis in able for s in {1, len(axis.levels)})]
    found = {
        (policy, condition): runner.play_one(episode(request.param, condition, policy))
        for condition in conditions
        for policy in ("untrained", "oracle")
    }
    runner.close()
    return found


def test_what_was_kept_of_other_episodes_changes_nothing(played):
    """The last table was painted beside references that other conditions had left, this one without."""
    condition = Condition("table", 5)
    kept = played["untrained", condition]
    runner = EpisodeRunner({"untrained": PolicySource("untrained")})
    alone = runner.play_one(episode(kept.task, condition, "untrained"))
    runner.close()
    assert (alone.delivered, alone.delivered_statistics) == (kept.delivered, kept.delivered_statistics)
    assert outcome_row(alone) == outcome_row(kept)


@pytest.mark.parametrize("task", ["maniskill/StackCube-v1", "pybullet/PandaPush-v3", "robosuite/Stack"])
def test_every_axis_measures_against_the_very_look_of_the_clean_episode(task):
    """To the bit, since whichever axis comes first draws it for the others of the seed."""
    simulation = open_simulation(task, VIEW)
    try:
        simulation.reset(7)
        clean = simulation.observe().images
        for axis in (axis for axis in AXES.values() if not why_unadjusted(axis, task)):
            condition = Condition(axis.name, len(axis.levels))
            scene = perturbed(simulation, episode(task, condition, "untrained"))
            if isinstance(scene, PerturbedScene):
                scene.reset(7)
                drawn = scene.clean_images()
                assert all((drawn[camera] == clean[camera]).all() for camera in clean), axis.name
    finally:
        simulation.close()


def test_every_axis_is_delivered_within_its_tolerance(played):
    for (policy, condition), row in played.items():
        assert row.status != Status.ERROR, row.error
        if policy == "untrained" and condition != Condition():
            axis = AXES[condition.axis]
            assert abs(row.delivered - axis.value(condition.severity)) <= axis.tolerance


def test_the_world_starts_as_in_the_clean_episode_but_where_something_is_moved(played):
    clean = played["oracle", Condition()].state_hash
    for (_, condition), row in played.items():
        if condition != Condition():
            assert (row.state_hash == clean) == AXES[condition.axis].changes.starts_clean


def test_what_is_only_seen_changes_nothing_for_an_oracle(played):
    clean = played["oracle", Condition()]
    for (policy, condition), row in played.items():
        if policy == "oracle" and condition != Condition() and AXES[condition.axis].changes not in FELT:
            assert (row.actions_hash, row.final_state_hash) == (clean.actions_hash, clean.final_state_hash)


def test_what_changes_anything_but_words_changes_what_becomes_of_an_untrained_policy(played):
    clean = played["untrained", Condition()]
    for name, axis in AXES.items():
        row = played.get(("untrained", Condition(name, len(axis.levels))))
        if row is None:
            continue
        # Three looks may all be fresh, and this policy neither reads nor touches anything.
        if name != "frozen-frames" and axis.changes not in (Changes.INSTRUCTION, Changes.BODIES, Changes.NOTHING):
            assert row.final_state_hash != clean.final_state_hash
        found = set(json.loads(row.delivered_statistics or "{}"))
        wanted = {Changes.IMAGES: {"psnr_third_person", "psnr_wrist"}, Changes.CAMERAS: {"turned_third_person"}}
        assert wanted.get(axis.changes, set()) <= found


def test_the_same_again_ends_alike_to_the_bit(played):
    for policy in ("untrained", "oracle"):
        once, again = played[policy, Condition()], played[policy, Condition("again", 1)]
        assert (once.actions_hash, once.final_state_hash) == (again.actions_hash, again.final_state_hash)
