"""Selections of a suite."""

import pytest

from robogauntlet.suites.registry import KnownPolicy, KnownTask, Registry
from robogauntlet.suites.schema import Suite
from robogauntlet.suites.selection import SelectionError, SuiteSelection

NAMES = Registry(
    tasks={"a/X": KnownTask(10), "a/Y": KnownTask(10), "b/Z": KnownTask(10)},
    policies={"one": KnownPolicy(), "two": KnownPolicy()},
)


@pytest.fixture
def suite():
    return Suite(
        name="s",
        policies=["one", "two", {"kind": "two", "name": "three"}],
        tasks=["a/*", "b/Z"],
        seeds={"start": 3, "count": 5},
        merging={"expert": "one", "oracle_routed": "two", "routed": ["three"]},
    ).with_names(NAMES)


def ids(suite):
    digests = {policy.name: policy.name for policy in suite.policies}
    return {cell.episode(seed).id for cell in suite.cells(NAMES, digests) for seed in suite.seeds}


def test_selecting_everything_changes_nothing(suite):
    assert SuiteSelection().apply_to(suite) == suite


def test_a_selection_has_episodes_of_the_whole_suite(suite):
    part = SuiteSelection(policies=("t*",), tasks=("a/Y",), seeds=2).apply_to(suite)
    assert len(ids(part)) == 2 * 1 * 2
    assert ids(part) < ids(suite)


def test_a_comparison_is_kept_only_with_all_its_policies(suite):
    assert SuiteSelection(tasks=("b/Z",)).apply_to(suite).merging == suite.merging
    assert SuiteSelection(policies=("one", "two")).apply_to(suite).merging is None


@pytest.mark.parametrize(
    ("part", "message"),
    [
        (SuiteSelection(policies=("thre",)), "no policy 'thre'; did you mean 'three'"),
        (SuiteSelection(tasks=("a/V",)), "no task 'a/V'; did you mean"),
        (SuiteSelection(tasks=("c/*",)), r"no task 'c/\*'"),
        (SuiteSelection(seeds=0), "expected 1 to 5 seeds, got 0"),
        (SuiteSelection(seeds=6), "expected 1 to 5 seeds, got 6"),
    ],
)
def test_a_selection_outside_the_suite_is_refused(suite, part, message):
    with pytest.raises(SelectionError, match=message):
        part.apply_to(suite)
