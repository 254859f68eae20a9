"""Every router on the same sightings."""

from itertools import count

import pytest

from policies.mergevla.routing.catalog import FITTED, NAMES, UNFITTED, fit_routers, router
from policies.mergevla.routing.contract import RoutingError
from policies.mergevla.routing.demonstrations import FirstSightings
from policies.mergevla.routing.trials import all_routers, judge, unknown_tasks
from tests.policies.mergevla.routing.synthetic import EXPERTS, SmallCandidates, frames


@pytest.fixture(scope="module")
def candidates():
    return SmallCandidates()


@pytest.fixture(scope="module")
def stored(candidates):
    return fit_routers(candidates, frames(0, 8), frames(50, 6))


@pytest.fixture
def new():
    return [sighting for own in frames(9000, 4).values() for sighting in own]


class Turns:
    """A clock that is a second later each time."""

    def __init__(self):
        self.ticks = count()

    def __call__(self):
        return float(next(self.ticks))


def test_every_router_is_tried_with_the_instruction_and_without(stored):
    assert [(one.name, one.sees_instruction) for one in all_routers(stored)] == [
        (name, sees) for name in NAMES for sees in (True, False)
    ]


def test_routers_that_were_not_fitted_are_left_out():
    assert {one.name for one in all_routers({})} == set(UNFITTED)


def test_routers_are_judged_by_what_they_choose(candidates, stored, new):
    found = judge(all_routers(stored), candidates, new).routers
    by_name = {(one.router, one.sees_instruction): one for one in found}
    for name in (*FITTED, "oracle"):
        for sees_instruction in (True, False):
            assert by_name[name, sees_instruction].study.total.right == len(new)
    assert by_name["instruction-match", True].study.total.right == len(new)
    assert by_name["instruction-match", False].study.total.right == len(new) / len(EXPERTS)
    assert [one.passes for one in found if one.sees_instruction] == [1, 0, 1, 0, 3, 3, 0]
    assert {one.router for one in found if one.study.calibrated} == {"calibrated"}


def test_a_decision_is_timed_by_itself_and_beside_a_pass(candidates, stored, new):
    told = []
    routers = [router("calibrated", stored=stored), router("random")]
    found = judge(routers, candidates, new[:3], listener=lambda *done: told.append(done), clock=Turns())
    assert found.pass_s == 1.0
    assert [(one.study.latency.median_s, one.relative_latency) for one in found.routers] == [(1.0, 1.0)] * 2
    assert told == [(0, 3), (1, 3), (2, 3), (3, 3)]


def test_nothing_to_route_is_refused(candidates):
    with pytest.raises(RoutingError, match="expected first observations to route, got none"):
        judge([], candidates, [])


def test_a_task_that_was_left_out_is_noticed(candidates):
    fitted_to = FirstSightings(frames(0, 12), frames(50, 8))
    found = unknown_tasks(candidates, fitted_to, frames(9000, 5))
    assert [(one.router, one.sees_instruction) for one in found] == [
        (name, sees) for name in ("calibrated", "nearest-centroid") for sees in (True, False)
    ]
    for one in found:
        assert one.left_out.by_task.keys() == set(EXPERTS)
        assert {(task.known, task.unknown) for task in one.left_out.by_task.values()} == {(10, 5)}
        assert one.left_out.auroc > 0.95
        assert one.left_out.rejected > 0.9


def test_tasks_that_were_not_looked_at_are_not_left_out(candidates):
    fitted_to = FirstSightings(frames(0, 12), frames(50, 8))
    found = unknown_tasks(candidates, fitted_to, frames(9000, 5, EXPERTS[:2]))
    assert found[0].left_out.by_task.keys() == set(EXPERTS[:2])
    with pytest.raises(RoutingError, match=r"expected sightings of two or more of .* to judge by, got null/Push"):
        unknown_tasks(candidates, fitted_to, frames(9000, 5, EXPERTS[:1]))
