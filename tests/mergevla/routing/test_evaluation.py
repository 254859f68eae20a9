"""Every router on the same observations."""

from functools import partial
from itertools import count, product

import numpy as np
import pytest

from robogauntlet_mergevla.routing.catalog import NAMES, UNFITTED, router
from robogauntlet_mergevla.routing.contract import RoutingError
from robogauntlet_mergevla.routing.demonstrations import RouterTrainingSet
from robogauntlet_mergevla.routing.evaluation import all_routers, evaluate_routers, leave_one_out, unknown_tasks
from robogauntlet_mergevla.routing.features import FeatureSpec
from robogauntlet_mergevla.routing.fitted_router import fit_centroids
from robogauntlet_mergevla.routing.gaussian import fit
from tests.mergevla.routing.synthetic import EXPERTS, frames, gaussians


@pytest.fixture
def new():
    return [observation for own in frames(9000, 4).values() for observation in own]


def right(observations):
    return sum(trial.task == trial.routing.choice for trial in observations.answers)


def auroc(left_out):
    """Share of pairs in which the unknown one's score is higher."""
    return np.greater.outer(left_out.unknown, left_out.known).mean()


def test_every_router_is_tried_with_the_instruction_and_without(stored):
    assert [(one.name, one.sees_instruction) for one in all_routers(stored)] == list(product(NAMES, (True, False)))


def test_routers_that_were_not_fitted_are_left_out():
    assert {one.name for one in all_routers({})} == set(UNFITTED)


def test_routers_are_evaluated_by_their_choices(model, stored, new):
    found = evaluate_routers(all_routers(stored), model, new).routers
    by_name = {(one.router, one.sees_instruction): one for one in found}
    for name in ("calibrated", "nearest-centroid", "oracle"):
        for sees_instruction in (True, False):
            assert right(by_name[name, sees_instruction]) == len(new)
    assert right(by_name["instruction-match", True]) == len(new)
    assert right(by_name["instruction-match", False]) == len(new) / len(EXPERTS)
    assert [one.passes for one in found if one.sees_instruction] == [1, 1, 0, 1, 0, 3, 3, 0, 1]


def test_only_gaussian_classes_answer_with_probabilities(model, stored, new):
    sums = {
        one.router: np.exp([list(trial.routing.scores.values()) for trial in one.answers]).sum(axis=1)
        for one in evaluate_routers(all_routers(stored), model, new).routers
    }
    assert [name for name, values in sums.items() if np.allclose(values, 1.0, atol=1e-3)] == [
        "calibrated",
        "self-trained",
    ]


def test_a_decision_and_a_pass_are_timed_separately(model, stored, new):
    progress, clock = [], count(0.0).__next__
    routers = [router("calibrated", stored=stored), router("random")]
    found = evaluate_routers(routers, model, new[:3], listener=lambda *done: progress.append(done), clock=clock)
    assert found.pass_s == 1.0
    assert [trial.routing.latency_s for one in found.routers for trial in one.answers] == [1.0] * 6
    assert progress == [(0, 3), (1, 3), (2, 3), (3, 3)]


def test_nothing_to_route_is_refused(model):
    with pytest.raises(RoutingError, match="expected first observations to route, got none"):
        evaluate_routers([], model, [])


def test_a_task_that_was_left_out_is_detected(model):
    fitted_to = RouterTrainingSet(frames(0, 12), frames(50, 8))
    found = unknown_tasks(model, fitted_to, frames(9000, 5))
    tried = [(one.router, one.sees_instruction) for one in found]
    assert tried == list(product(("calibrated", "nearest-centroid"), (True, False)))
    for one in found:
        assert one.by_task.keys() == set(EXPERTS)
        assert {(len(task.known), len(task.unknown)) for task in one.by_task.values()} == {(10, 5)}
        assert np.mean([auroc(task) for task in one.by_task.values()]) > 0.95
        assert np.mean([np.greater(task.unknown, task.threshold) for task in one.by_task.values()]) > 0.9


def test_tasks_without_new_observations_are_not_left_out(model):
    fitted_to = RouterTrainingSet(frames(0, 12), frames(50, 8))
    found = unknown_tasks(model, fitted_to, frames(9000, 5, EXPERTS[:2]))
    assert found[0].by_task.keys() == set(EXPERTS[:2])
    with pytest.raises(RoutingError, match=r"expected observations of two or more of .* to score, got null/Push"):
        unknown_tasks(model, fitted_to, frames(9000, 5, EXPERTS[:1]))


@pytest.mark.parametrize(
    "fitted", [partial(fit, feature_spec=FeatureSpec()), partial(fit_centroids, feature_spec=FeatureSpec())]
)
def test_a_left_out_task_is_detected_if_it_is_separable(fitted):
    found = leave_one_out(fitted, gaussians(0), gaussians(1), gaussians(2, count=100, classes=("a", "b", "c")))
    assert found.keys() == {"a", "b", "c"}
    assert {(len(one.known), len(one.unknown)) for one in found.values()} == {(200, 100)}
    assert min(map(auroc, found.values())) > 0.99
    assert np.mean([np.greater(one.unknown, one.threshold) for one in found.values()]) > 0.95
    assert 0.0 < np.mean([np.greater(one.known, one.threshold) for one in found.values()]) < 0.15


def test_a_left_out_task_whose_features_are_those_of_another_is_not_detected():
    near = (gaussians(seed, apart=0.0) for seed in range(3))
    found = leave_one_out(partial(fit, feature_spec=FeatureSpec()), *near)
    assert 0.4 < np.mean([auroc(one) for one in found.values()]) < 0.6


def test_routers_can_be_named_with_their_options(stored):
    wanted = ["paper-coded:projections=k", "calibrated"]
    assert [one.name for one in all_routers(stored, wanted)] == [wanted[0], wanted[0], wanted[1], wanted[1]]
    with pytest.raises(RoutingError, match="unknown router 'nearest'"):
        all_routers(stored, ["nearest"])
