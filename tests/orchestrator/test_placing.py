"""Where a free place goes, by what is left to do."""

from hypothesis import given
from hypothesis import strategies as st

from orchestrator.placing import START_S, Demand, most_needed

DEMANDS = st.dictionaries(st.sampled_from("abc"), st.builds(Demand, st.floats(0, 1e6), st.integers(0, 4)))


def test_a_simulator_without_a_worker_comes_first():
    assert most_needed({"a": Demand(1000.0, 1), "b": Demand(1.0, 0)}) == "b"


def test_then_the_one_with_the_most_work_left_for_each_worker():
    assert most_needed({"a": Demand(1000.0, 3), "b": Demand(900.0, 1)}) == "b"


def test_a_place_stays_idle_where_starting_a_worker_would_take_longer_than_the_work():
    assert most_needed({"a": Demand(1.9 * START_S, 1)}) is None
    assert most_needed({"a": Demand(2.1 * START_S, 1)}) == "a"


@given(DEMANDS)
def test_a_place_goes_where_there_is_work_and_no_simulator_is_left_without_a_worker(demands):
    chosen = most_needed(demands)
    unattended = {name for name, demand in demands.items() if demand.waiting_s > 0 and not demand.workers}
    if chosen is not None:
        assert demands[chosen].waiting_s > 0
    if unattended:
        assert chosen in unattended
