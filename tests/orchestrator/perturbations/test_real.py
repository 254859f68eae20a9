"""Every axis in the three real simulators: the level is delivered, and nothing else changes."""

import json

import pytest

from robogauntlet.adapters.catalog import open_simulation
from robogauntlet.orchestrator.episodes.episode_runner import EpisodeRunner
from robogauntlet.orchestrator.episodes.policy_source import PolicySource
from robogauntlet.orchestrator.perturbations import perturbed
from robogauntlet.orchestrator.perturbations.base import PerturbedScene
from robogauntlet.orchestrator.registry import why_unadjusted
from robogauntlet.results.record import Status, outcome_row
from robogauntlet.suites.axes import AXES
from robogauntlet.suites.axis import Changes
from robogauntlet.suites.episode import CONTROLS, Condition, Episode, Perturbation, Protocol, RenderProfile, View
from tests.jobs import mostly_nightly

pytestmark = pytest.mark.simulator
TASKS = ("maniskill/PushCube-v1", "pybullet/PandaPush-v3", "robosuite/Lift")
AFFECT_ORACLES = {Changes.ACTIONS, Changes.OBJECTS, Changes.ARM, Changes.DYNAMICS}
"""Changes that affect an oracle, which does not observe images."""
VIEW = View(image_size=96, render_profile=RenderProfile.FAST_2)


def episode(task, condition, policy):
    return Episode(policy, policy, task, 7, Protocol(24, 8, VIEW), condition)


@pytest.fixture(scope="module", params=TASKS)
def played(request):
    """The record of a short episode, clean and under every axis: at severities 1 and 5, for the oracle at 5 alone."""
    runner = EpisodeRunner({name: PolicySource(name) for name in ("untrained", "oracle")})
    supported = [axis for axis in AXES.values() if not why_unadjusted(axis, request.param)]
    strongest = [Condition(), *(Condition(axis.name, len(axis.levels)) for axis in supported)]
    weak = [Condition(axis.name, 1) for axis in supported if len(axis.levels) > 1]
    # The weak ones first: `test_cached_references_change_no_result` needs what they leave in the cache.
    results = {
        (policy, condition): runner.play_one(episode(request.param, condition, policy))
        for policy, conditions in (("untrained", [*weak, *strongest]), ("oracle", strongest))
        for condition in conditions
    }
    runner.close()
    return results


def test_cached_references_change_no_result(played):
    """The first table was painted with cached references of other conditions, the second without."""
    condition = Condition("table", 5)
    kept = played["untrained", condition]
    runner = EpisodeRunner({"untrained": PolicySource("untrained")})
    alone = runner.play_one(episode(kept.task, condition, "untrained"))
    runner.close()
    assert (alone.delivered, alone.delivered_statistics) == (kept.delivered, kept.delivered_statistics)
    assert outcome_row(alone) == outcome_row(kept)


@pytest.mark.parametrize("task", ["maniskill/StackCube-v1", "pybullet/PandaPush-v3", "robosuite/Stack"])
def test_every_axis_compares_with_the_bit_identical_images_of_the_clean_episode(task):
    """Bit-identical, because the first axis renders them for the other axes of the seed."""
    simulation = open_simulation(task, VIEW)
    try:
        simulation.reset(7)
        clean = simulation.observe().images
        for axis in (axis for axis in AXES.values() if not why_unadjusted(axis, task)):
            condition = Condition(axis.name, len(axis.levels))
            scene = perturbed(simulation, episode(task, condition, "untrained"))
            if isinstance(scene, PerturbedScene):
                scene.reset(7)
                rendered = scene.clean_images()
                assert all((rendered[camera] == clean[camera]).all() for camera in clean), axis.name
    finally:
        simulation.close()


def test_every_axis_is_delivered_within_its_tolerance(played):
    for (policy, condition), row in played.items():
        assert row.status != Status.ERROR, row.error
        if policy == "untrained" and condition != Condition():
            axis = AXES[condition.axis]
            if axis.name not in (*CONTROLS, "instruction"):
                assert abs(row.delivered - axis.value(condition.severity)) <= axis.tolerance


def test_start_states_are_clean_unless_the_axis_changes_them(played):
    clean = played["oracle", Condition()].state_hash
    for (_, condition), row in played.items():
        if condition != Condition():
            assert (row.state_hash == clean) == AXES[condition.axis].changes.starts_clean


def test_changes_of_appearance_do_not_affect_an_oracle(played):
    clean = played["oracle", Condition()]
    for (policy, condition), row in played.items():
        if policy == "oracle" and condition != Condition() and AXES[condition.axis].changes not in AFFECT_ORACLES:
            assert (row.actions_hash, row.final_state_hash) == (clean.actions_hash, clean.final_state_hash)


def test_every_axis_except_instructions_changes_the_outcome_of_an_untrained_policy(played):
    clean = played["untrained", Condition()]
    for name, axis in AXES.items():
        row = played.get(("untrained", Condition(name, len(axis.levels))))
        if row is None:
            continue
        # All three observations may be new, and this policy neither reads nor touches anything.
        if name != "frozen-frames" and axis.changes not in (Changes.INSTRUCTION, Changes.DYNAMICS, Changes.NOTHING):
            assert row.final_state_hash != clean.final_state_hash
        found = set(json.loads(row.delivered_statistics or "{}"))
        wanted = {Changes.IMAGES: {"psnr_third_person", "psnr_wrist"}, Changes.CAMERAS: {"turned_third_person"}}
        assert wanted.get(axis.changes, set()) <= found


def test_a_repeated_episode_is_bit_identical(played):
    for policy in ("untrained", "oracle"):
        once, again = played[policy, Condition()], played[policy, Condition("again", 1)]
        assert (once.actions_hash, once.final_state_hash) == (again.actions_hash, again.final_state_hash)


@pytest.mark.parametrize(
    "without", mostly_nightly([("camera-bump",), ("camera-orbit", "camera-distance")], [("camera-bump",)]), ids="-".join
)
@pytest.mark.parametrize("task", TASKS)
def test_all_axes_that_combine_are_delivered_together_and_undone(task, without):
    """At severities between whole ones; the clean episode is the same before and after."""
    without = (*without, "latency", "latency-blend")  # the robot waits for an answer in one way
    axes = [a for n, a in AXES.items() if n not in (*CONTROLS, *without) and not why_unadjusted(a, task)]
    parts = [Perturbation(axis.name, 1 if axis.unchanged is None else 1.5) for axis in axes]
    condition = Condition.of(*parts)
    runner = EpisodeRunner({"untrained": PolicySource("untrained")})
    try:
        clean, row, again, after = (
            runner.play_one(episode(task, one, "untrained")) for one in (Condition(), condition, condition, Condition())
        )
    finally:
        runner.close()
    assert row.status != Status.ERROR, row.error
    assert outcome_row(row) == outcome_row(again)
    assert outcome_row(clean) == outcome_row(after)
    found = json.loads(row.delivered_statistics)
    for part in parts:
        axis = AXES[part.axis]
        if part.axis not in ("instruction", "distractors"):  # moved cameras show fewer distractors
            assert abs(found[part.axis] - axis.value(part.severity)) <= axis.tolerance + 1e-6, part
