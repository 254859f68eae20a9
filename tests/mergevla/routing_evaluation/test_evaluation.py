"""The routing evaluation and the report of a run compute the same metrics from the same answers."""

import numpy as np
import pytest

from robogauntlet.adapters import catalog
from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.policies.contract import Decision, PolicyInput, PolicySpec, Routing
from robogauntlet.results.report import write_report
from robogauntlet.suites.schema import MergingEntry
from robogauntlet_mergevla.routing.evaluation import LeaveOneOutScores, RoutedObservation
from robogauntlet_mergevla.routing_evaluation.evaluation import detection_of, quality_of
from tests.results.synthetic import cells, document, run_folder

EXPERTS = ("null/Reach", "null/Slow", "null/Raise")
UNKNOWN = "null/Hang"
SEEDS = range(1, 7)
"""No multiples of seven, for which `Raise` and `Hang` fail."""
ROLES = MergingEntry(expert="experts", oracle_routed="oracle-routed", routed=("merged",))
THRESHOLD = 0.5


@pytest.fixture(scope="module")
def trials():
    """Answers of an inaccurate, badly calibrated router for known and unknown tasks."""
    generator = np.random.default_rng(0)
    answers = []
    for task in (*EXPERTS, UNKNOWN):
        for _ in SEEDS:
            scores = np.log(generator.dirichlet([1.0] * len(EXPERTS)))
            unknown = float(generator.normal(float(task == UNKNOWN), 1.0))
            choice = EXPERTS[int(scores.argmax())]
            routing = Routing(
                dict(zip(EXPERTS, scores.tolist(), strict=True)), choice, 0.02, unknown, unknown > THRESHOLD
            )
            answers.append(RoutedObservation(task, routing))
    return answers


class Answering:
    """A policy that does not move and returns these routings one by one."""

    spec = PolicySpec(PolicyInput.NOTHING, chunk_length=100)

    def __init__(self, trials):
        self._waiting = [trial.routing for trial in trials]

    def reset(self, episodes):
        pass

    def act(self, queries):
        (query,) = queries
        return [Decision(np.zeros((100, 7)), self._waiting.pop(0) if query.step == 0 else None)]

    def finish(self, episodes):
        pass


@pytest.fixture(scope="module")
def reported(trials, tmp_path_factory):
    """The router in the report of a run in which a policy gave these answers."""
    plan = cells(("experts", "oracle-routed", "merged"), (*EXPERTS, UNKNOWN))
    rows, policy = [], Answering(trials)
    for cell in plan:
        if cell.policy == "merged":
            simulation = catalog.open_simulation(cell.task, cell.protocol.view)
            rows += [rollout(simulation, policy, cell.episode(seed)) for seed in SEEDS]
            simulation.close()
    folder = run_folder(tmp_path_factory.mktemp("run"), document(len(SEEDS), plan, merging=ROLES), rows)
    return write_report(folder).data["routing"][0].router


def test_accuracy_calibration_and_detection_are_equal(trials, reported):
    found = quality_of(trials)
    assert found.accuracy.trials == len(EXPERTS) * len(SEEDS)
    assert found.calibration.expected_error > 0.05
    assert found.accuracy == reported.accuracy
    assert found.calibration == reported.calibration
    assert found.detection == reported.detection


def test_detection_of_a_left_out_task_equals_that_of_an_unknown_task_in_a_run(trials, reported):
    known, unknown = (
        tuple(trial.routing.unknown for trial in trials if (trial.task == UNKNOWN) is is_unknown)
        for is_unknown in (False, True)
    )
    assert detection_of(LeaveOneOutScores(known, unknown, THRESHOLD)) == reported.detection
