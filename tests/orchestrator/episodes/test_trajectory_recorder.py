"""What an episode's record has: the images that a policy would have seen, the states, the commanded actions."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from robogauntlet.adapters import catalog
from robogauntlet.orchestrator.episodes.trajectory_recorder import TrajectoryRecorder
from robogauntlet.orchestrator.perturbations import perturbed
from robogauntlet.suites.episode import Condition, Episode, Protocol, View

VIEW = View(image_size=16)
TASK = "null/Reach"


@pytest.mark.parametrize("axis", ["noise", "frozen-frames", "blank-instruction", "blind"])
@settings(max_examples=20)
@given(st.lists(st.booleans(), min_size=1, max_size=12), st.integers(0, 50))
def test_a_preview_equals_the_observation_and_changes_nothing(axis, observed, seed):
    severity = 1 if axis.startswith("bl") else 4
    one = Episode("p", "digest", TASK, seed, Protocol(60, 1, View(image_size=8)), Condition(axis, severity))
    seen = []
    for previewed in (False, True):
        simulation = perturbed(catalog.open_simulation(TASK, one.protocol.view), one)
        simulation.reset(seed)
        shown = []
        for observes in observed:
            preview = simulation.preview() if previewed else None
            if observes:
                shown.append(simulation.observe())
                if preview is not None:
                    assert all(np.array_equal(preview.images[c], shown[-1].images[c]) for c in preview.images)
                    assert preview.instruction == shown[-1].instruction
            simulation.step(np.array([0.01, 0, 0, 0, 0, 0, 0]))
        seen.append((shown, simulation.delivered()))
    (plain, delivered), (observed_again, after) = seen
    assert delivered == after
    assert all(
        np.array_equal(a.images[c], b.images[c]) for a, b in zip(plain, observed_again, strict=True) for c in a.images
    )


def test_a_record_holds_the_state_before_each_step_and_the_commanded_action():
    simulation = catalog.open_simulation(TASK, VIEW)
    recorder = TrajectoryRecorder(simulation)
    one = Episode("p", "digest", TASK, 3, Protocol(60, 8, VIEW), Condition("action-noise", 3))
    outer = perturbed(recorder, one)
    outer.reset(3)
    recorder.watch(outer, 0)
    commanded, places = np.array([0.02, 0, 0, 0, 0, 0, 0]), []
    for _ in range(4):
        places.append(simulation.observe().proprioception)
        outer.step(commanded)
    found = recorder.recording()
    assert np.array_equal(found.states, places)
    assert np.all(found.actions == commanded)
    assert not np.array_equal(np.diff(found.states[:, :3], axis=0), found.actions[:-1, :3])
