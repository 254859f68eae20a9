"""A suite expands to cells, and its hash says what is evaluated, not how."""

import pytest

from robogauntlet.suites.loading import load_suite
from robogauntlet.suites.registry import KnownPolicy, KnownTask, Registry
from robogauntlet.suites.schema import PolicyEntry, Suite
from tests import ROOT

NAMES = Registry(
    tasks={"a/One": KnownTask(50), "a/Two": KnownTask(70), "b/One": KnownTask(90)},
    policies={"oracle": KnownPolicy(), "random": KnownPolicy()},
    axes={"light": 5},
)
DIGESTS = {"oracle": "0", "random": "1"}
MERGING = {"merging": {"expert": "oracle", "oracle_routed": "random", "routed": "merged"}}


def suite(**changes):
    data = {"name": "s", "policies": ["oracle", "random"], "tasks": ["a/One", "b/One"], "seeds": {"count": 3}}
    return Suite.model_validate({**data, **changes})


def test_cells_are_the_product_with_tasks_outermost():
    conditions = ["clean", {"axis": "light", "severities": [2]}]
    cells = suite(conditions=conditions).cells(NAMES, DIGESTS)
    assert [(c.task, str(c.condition), c.policy) for c in cells] == [
        (task, condition, policy)
        for task in ("a/One", "b/One")
        for condition in ("clean", "light@2")
        for policy in ("oracle", "random")
    ]


def test_the_horizon_is_the_tasks_own_unless_the_suite_sets_it():
    assert {c.task: c.protocol.horizon for c in suite().cells(NAMES, DIGESTS)} == {"a/One": 50, "b/One": 90}
    assert {c.protocol.horizon for c in suite(horizon=20).cells(NAMES, DIGESTS)} == {20}


@pytest.mark.parametrize(
    "changes",
    [
        *({"workers": 3}, {"workers": "auto"}, {"name": "t"}, {"error_tolerance": 0.5}, {"description": "x"}),
        *({"tasks": ["b/One", "a/One"]}, MERGING),
    ],
)
def test_the_hash_ignores_how_a_suite_is_run(changes):
    assert suite(**changes).content_hash(DIGESTS, NAMES) == suite().content_hash(DIGESTS, NAMES)


@pytest.mark.parametrize(
    "changes",
    [
        *({"seeds": {"count": 4}}, {"seeds": {"start": 1, "count": 3}}, {"replan_every": 4}, {"horizon": 10}),
        *({"image_size": 64}, {"render_profile": "fast"}, {"cameras": ["wrist"]}),
        *({"policies": ["oracle"]}, {"tasks": ["a/One", "a/Two"]}),
        {"conditions": [{"axis": "light", "severities": [1]}]},
    ],
)
def test_the_hash_depends_on_what_is_evaluated(changes):
    assert suite(**changes).content_hash(DIGESTS, NAMES) != suite().content_hash(DIGESTS, NAMES)


def test_another_policy_content_is_another_suite_hash():
    assert suite().content_hash({**DIGESTS, "random": "2"}, NAMES) != suite().content_hash(DIGESTS, NAMES)


def test_the_margin_of_a_comparison_is_not_in_the_hash_of_an_adaptive_suite():
    plain, tested = (
        suite(compare={"baseline": "random", "others": ["zero"], **margin}, adaptive={"max_seeds": 9})
        for margin in ({}, {"margin": 0.05})
    )
    assert tested.content_hash(DIGESTS, NAMES) == plain.content_hash(DIGESTS, NAMES)


def test_one_routed_policy_needs_no_list():
    assert suite(**MERGING).merging.routed == ("merged",)


def test_simulators_share_all_workers_unless_their_numbers_are_given():
    assert suite().workers == "auto"
    assert [suite(workers={"a": 4}).worker_count(name) for name in ("a", "b")] == [4, 1]
    assert suite(workers=2).worker_count("b") == 2


@pytest.mark.parametrize("path", sorted((ROOT / "suites").glob("*.yaml")), ids=lambda p: p.stem)
def test_a_shipped_suite_is_valid(path):
    from robogauntlet.orchestrator.registry import load_registry

    assert load_suite(path, load_registry()).name == path.stem


@pytest.mark.parametrize(
    ("text", "entry"),
    [
        ("oracle", ("oracle", "oracle", {})),
        ("openpi://127.0.0.1:8000", ("openpi-127.0.0.1-8000", "openpi", {"address": "openpi://127.0.0.1:8000"})),
        ("python:brains.reach:Reach", ("python-brains.reach-Reach", "python", {"callable": "brains.reach:Reach"})),
    ],
)
def test_a_short_form_is_a_kind_with_its_one_option(text, entry):
    found = PolicyEntry.model_validate(text)
    assert (found.name, found.kind, found.options) == entry


@pytest.mark.parametrize("text", ["oracle:", "openpi:", "nobody:there", ":x", "python :x"])
def test_an_invalid_short_form_is_refused_as_a_name(text):
    with pytest.raises(ValueError, match="name"):
        PolicyEntry.model_validate(text)
