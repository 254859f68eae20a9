"""A part of a suite has the whole one's episodes."""

import pytest

from suites.known import KnownNames, KnownPolicy, KnownTask
from suites.part import NoSuchPart, Part
from suites.schema import Suite

NAMES = KnownNames(
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


def test_everything_is_the_suite_itself(suite):
    assert Part().of(suite) == suite


def test_its_episodes_are_among_the_whole_suites(suite):
    part = Part(policies=("t*",), tasks=("a/Y",), seeds=2).of(suite)
    assert len(ids(part)) == 2 * 1 * 2
    assert ids(part) < ids(suite)


def test_a_comparison_is_kept_only_with_all_its_policies(suite):
    assert Part(tasks=("b/Z",)).of(suite).merging == suite.merging
    assert Part(policies=("one", "two")).of(suite).merging is None


@pytest.mark.parametrize(
    ("part", "message"),
    [
        (Part(policies=("thre",)), "no policy 'thre'; did you mean 'three'"),
        (Part(tasks=("a/V",)), "no task 'a/V'; did you mean"),
        (Part(tasks=("c/*",)), r"no task 'c/\*'"),
        (Part(seeds=0), "expected 1 to 5 seeds, got 0"),
        (Part(seeds=6), "expected 1 to 5 seeds, got 6"),
    ],
)
def test_what_the_suite_does_not_have_is_refused(suite, part, message):
    with pytest.raises(NoSuchPart, match=message):
        part.of(suite)
