"""The identity of an episode."""

import dataclasses
import subprocess
import sys

import pytest
from hypothesis import given, strategies as st

from robogauntlet.suites.episode import (
    CAMERAS,
    Cell,
    Condition,
    Episode,
    Protocol,
    ProtocolName,
    RenderProfile,
    SuccessRule,
    View,
    content_hash,
)

names = st.text("abcXYZ-_/0", min_size=1, max_size=8)
conditions = st.builds(Condition, names, st.integers(0, 5))
views = st.builds(View, st.sampled_from([CAMERAS, CAMERAS[:1]]), st.integers(16, 256), st.sampled_from(RenderProfile))
rules = st.sampled_from([None, *SuccessRule])
protocols = st.builds(Protocol, st.integers(1, 500), st.integers(1, 32), views, st.sampled_from(ProtocolName), rules)
EPISODE = Episode("oracle", "0123", "robosuite/Lift", 7, Protocol(100, 8, View()), Condition())
episodes = st.builds(Episode, names, names, names, st.integers(0, 2**31), protocols, conditions)


@given(episodes)
def test_the_policys_name_is_no_part_of_the_identity(episode):
    assert dataclasses.replace(episode, policy="another-name").id == episode.id


@given(episodes, st.data())
def test_any_other_difference_changes_the_id(episode, data):
    field = data.draw(st.sampled_from(["policy_digest", "task", "seed", "protocol", "condition"]))
    other = getattr(data.draw(episodes), field)
    changed = dataclasses.replace(episode, **{field: other})
    assert (changed.id == episode.id) == (other == getattr(episode, field))


@given(episodes, names)
def test_two_policies_of_one_pair_share_the_pair_id(episode, digest):
    other = dataclasses.replace(episode, policy="other", policy_digest=digest)
    assert other.pair_id == episode.pair_id
    assert (other.id == episode.id) == (digest == episode.policy_digest)


def test_the_id_is_frozen():
    assert (EPISODE.id, EPISODE.pair_id) == ("c1f4f900d7dc52bb", "8df80ca93d72308d")


@pytest.mark.parametrize("axis", ["robot-start", "noise@1.5+robot-start@2", "noise"])
def test_an_episode_of_an_axis_that_changed_has_no_pair_among_those_of_before(axis):
    now = dataclasses.replace(EPISODE, condition=Condition(axis, 1))
    before = dataclasses.replace(now, axis_version=1)
    assert (now.pair_id != before.pair_id) == (axis != "noise")


def test_datasets_know_robogauntlets_own_protocol_by_the_fields_of_before_it_had_a_name():
    own = Protocol(100).described()
    assert set(own) == {"horizon", "replan_every", "view"}
    assert Protocol(100, name=ProtocolName.OPENVLA).described() == own | {"name": "openvla"}


@pytest.mark.parametrize("name", ProtocolName)
def test_a_rule_is_part_of_the_identity_unless_it_is_the_protocols_own(name):
    plain = Protocol(100, name=name)
    rules = {rule: Protocol(100, name=name, success=rule) for rule in SuccessRule}
    own = rules.pop(name.success_rule)
    (other,) = rules.values()
    assert (own, own.described()) == (plain, plain.described())
    assert other.described() == plain.described() | {"success": other.success_rule}
    ids = {dataclasses.replace(EPISODE, protocol=one).pair_id for one in (plain, own, other)}
    assert len(ids) == 2


def test_the_id_is_the_same_in_another_process():
    code = (
        "from robogauntlet.suites.episode import *;"
        "print(Episode('oracle', '0123', 'robosuite/Lift', 7, Protocol(100, 8, View()), Condition()).id)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == EPISODE.id


def test_a_cell_gives_its_episode_of_a_seed():
    cell = Cell("oracle", "0123", "robosuite/Lift", Protocol(100), Condition("light", 2))
    assert cell.episode(5) == Episode("oracle", "0123", "robosuite/Lift", 5, Protocol(100), Condition("light", 2))
    assert cell.simulator == cell.episode(5).simulator == "robosuite"


@given(st.dictionaries(names, st.integers()))
def test_a_content_hash_ignores_the_order_of_keys(content):
    assert content_hash(dict(reversed(content.items()))) == content_hash(content)


def test_the_vocabulary_loads_without_heavy_libraries():
    heavy = ("numpy", "torch", "ray", "pandas")
    modules = "robogauntlet.suites.loading, robogauntlet.suites.schema"
    code = f"import sys, {modules}; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
