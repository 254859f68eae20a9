"""Combinations of axes in the null simulator: each is applied, drawn and measured as it is alone."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import example, given, strategies as st

from robogauntlet.adapters.contract import NotDelivered, UnsupportedCondition
from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.orchestrator.perturbations import instructions, perturbed
from robogauntlet.orchestrator.perturbations.cameras import MovedCameras
from robogauntlet.suites.axes import AXES, why_exclusive
from robogauntlet.suites.axis import Changes
from robogauntlet.suites.episode import CONTROLS, Condition, Episode, Perturbation, Protocol
from robogauntlet.suites.paraphrases import PARAPHRASES
from tests.orchestrator.episodes.test_rollout import Scripted
from tests.orchestrator.perturbations.scene import Scene

SCALES = [name for name in AXES if name not in CONTROLS]
ALL = [name for name in SCALES if name not in ("camera-bump", "latency-continue", "latency-blend")]
"""The most that combine."""


@pytest.fixture(autouse=True, scope="module")
def paraphrases():
    """Paraphrases for the null simulator's instruction."""
    table = dict(PARAPHRASES) | {"reach the goal": tuple(f"reach the goal, {kind}" for kind in range(1, 6))}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("robogauntlet.suites.paraphrases.PARAPHRASES", table)
        patch.setattr(instructions, "PARAPHRASES", table)
        yield


def condition_of(**severities):
    return Condition.of(*(Perturbation(name.replace("_", "-"), level) for name, level in severities.items()))


def begin(condition, seed=4):
    """A scene, and its perturbed simulation after the reset and the checks of a rollout."""
    scene = Scene()
    simulation = perturbed(scene, Episode("p", "p", "null/Reach", seed, Protocol(40), condition))
    simulation.reset(seed)
    simulation.check_start()
    return scene, simulation


def assert_delivered(condition, found):
    for part in condition.perturbations:
        axis = AXES[part.axis]
        if part.axis == "distractors":
            assert found[part.axis] <= axis.value(part.severity)  # a moved camera shows fewer
            continue
        assert found[part.axis] == pytest.approx(axis.value(part.severity), abs=axis.tolerance + 1e-9), part


@pytest.mark.parametrize("pair", [pair for pair in combinations(SCALES, 2) if not why_exclusive(pair)], ids="+".join)
def test_every_pair_delivers_both_levels(pair):
    condition = Condition.of(*(Perturbation(name, 3) for name in pair))
    _, simulation = begin(condition)
    observation = simulation.observe()
    simulation.check_instruction(observation.instruction)
    simulation.step(np.zeros(7))
    found = simulation.delivered()
    assert found.value is None
    assert_delivered(Condition.of(*(Perturbation(name, 3) for name in pair if measurable(name))), found.statistics)


def measurable(name):
    """Whether one observation and one step are enough to measure the axis."""
    return AXES[name].tolerance != float("inf")


def test_everything_at_once_delivers_every_level():
    condition = Condition.of(*(Perturbation(name, 2) for name in ALL if measurable(name)))
    _, simulation = begin(condition)
    simulation.observe()
    simulation.step(np.zeros(7))
    assert_delivered(condition, simulation.delivered().statistics)


fractions = st.integers(1, 500).map(lambda hundredths: hundredths / 100)


@given(st.sampled_from([name for name in ALL if AXES[name].unchanged is not None]), fractions)
@example("blur", 0.01)
def test_a_fractional_severity_delivers_its_interpolated_level(name, severity):
    condition = Condition.of(Perturbation(name, severity))
    _, simulation = begin(condition)
    simulation.observe()
    simulation.step(np.zeros(7))
    value = simulation.delivered().value
    if severity < 1 and (value is None or name in ("illuminance", "colour-temperature")):
        return  # eight bits may not show it, see `PerturbedGain` and `Blur`
    if measurable(name):
        assert value == pytest.approx(AXES[name].value(severity), abs=AXES[name].tolerance + 1e-9)


def test_an_axis_draws_in_a_combination_what_it_draws_alone():
    alone, _ = begin(Condition("camera-orbit", 3))
    scene, simulation = begin(condition_of(camera_orbit=3, table=2, robot_start=4))
    assert (scene.viewpoints["third_person"].position == alone.viewpoints["third_person"].position).all()
    moved, _ = begin(Condition("robot-start", 4))
    assert (scene.tool[0] == moved.tool[0]).all()
    assert simulation.state_hash() == moved.state_hash()


def test_an_axis_of_the_scene_is_measured_without_the_others():
    """A table is painted and measured in its own light, although the policy sees it in less."""
    scene, simulation = begin(condition_of(table=4, illuminance=5))
    seen = simulation.observe().images["third_person"]
    found = simulation.delivered().statistics
    assert found["table"] == pytest.approx(50, abs=5)
    assert found["illuminance"] == pytest.approx(3, abs=0.15)
    bright, painted = begin(Condition("table", 4))
    assert seen.mean() < 0.6 * painted.observe().images["third_person"].mean()
    assert (scene.texture == bright.texture).all()


def test_a_preview_changes_no_later_observation():
    condition = condition_of(noise=3, frozen_frames=5, table=2, illuminance=2)
    runs = []
    for previewed in (False, True):
        _, simulation = begin(condition)
        simulation.observe()
        images = []
        for _ in range(6):
            if previewed:
                simulation.preview()
            images.append(simulation.observe().images["wrist"][:, :, 0])
        runs.append((np.stack(images)[:, 70:], simulation.delivered()))
    assert (runs[0][0] == runs[1][0]).all()
    assert runs[0][1] == runs[1][1]


def test_actions_are_delayed_before_noise_is_added_and_the_command_is_kept():
    scene, simulation = begin(condition_of(action_delay=2, action_noise=3))
    action = np.array([0.01, 0.02, -0.03, 0, 0, 0, 1.0])
    simulation.step(action)
    assert (simulation.commanded == action).all()
    assert (scene.executed[0][:3] != 0).all()
    assert abs(scene.executed[0][:3]).max() < 0.03
    simulation.delivered()


def test_an_axis_that_misses_its_level_in_a_combination_is_an_error(monkeypatch):
    monkeypatch.setattr(MovedCameras, "_checked", lambda self, value: (_ for _ in ()).throw(self._not_delivered("no")))
    _, simulation = begin(condition_of(camera_orbit=3, illuminance=2))
    simulation.observe()
    with pytest.raises(NotDelivered, match="camera-orbit@3: no"):
        simulation.delivered()


def test_a_perturbation_that_moves_what_it_must_not_is_found_below_another(monkeypatch):
    from robogauntlet.orchestrator.perturbations.cameras import CameraOrbit

    reset = CameraOrbit.reset

    def reset_and_move(self, seed):
        reset(self, seed)
        self.scene_controls.objects.move("cube", np.array([0.01, 0.0]))

    monkeypatch.setattr(CameraOrbit, "reset", reset_and_move)
    with pytest.raises(NotDelivered, match="camera-orbit@3: expected the clean episode's physical state"):
        begin(condition_of(camera_orbit=3, illuminance=2))


def test_only_an_axis_of_the_instruction_may_change_it():
    _, simulation = begin(condition_of(noise=1, table=1))
    with pytest.raises(NotDelivered, match="expected the task's own instruction"):
        simulation.check_instruction("something else")
    begin(condition_of(noise=1, instruction=1))[1].check_instruction("something else")
    assert AXES["instruction"].changes is Changes.INSTRUCTION


@pytest.mark.parametrize("axis", ["camera-bump@1+camera-orbit@1", "blind@1+noise@1", "noise@1+no-axis@1"])
def test_what_does_not_combine_is_unsupported(axis):
    with pytest.raises(UnsupportedCondition):
        begin(Condition(axis, 1))


def test_the_rows_of_a_combination_have_what_each_axis_delivered():
    scene = Scene()
    condition = condition_of(camera_orbit=2.5, illuminance=1)
    row = rollout(scene, Scripted(), Episode("p", "p", "null/Reach", 4, Protocol(8), condition))
    assert (row.axis, row.severity, row.delivered) == ("camera-orbit@2.5+illuminance@1", 1, None)
    assert row.episode.condition == condition
    assert '"camera-orbit":15.0' in row.delivered_statistics.replace(" ", "")
