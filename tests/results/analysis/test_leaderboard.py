"""Tests of results/analysis/leaderboard.py."""

from contextlib import closing
from dataclasses import replace
from itertools import combinations

import pandas as pd
import pytest
from hypothesis import given, strategies as st

from robogauntlet.results.analysis.leaderboard import (
    COLUMNS,
    PolicyEpisodes,
    compact_letters,
    leaderboard,
)
from robogauntlet.results.newest_results import latest_results_per_policy
from robogauntlet.results.run_document import Provenance
from robogauntlet.results.statistics.rates import wilson_interval
from robogauntlet.results.store.database import file_url
from robogauntlet.results.store.history_import import record_run_folder
from robogauntlet.results.store.run_history import History
from robogauntlet.suites.episode import SuccessRule
from tests.results.synthetic import cells, document, row, run_folder


@st.composite
def known_differences(draw):
    count = draw(st.integers(1, 7))
    pairs = [(a, b) for a in range(count) for b in range(a + 1, count)]
    return count, {frozenset(pair) for pair in draw(st.lists(st.sampled_from(pairs), unique=True))} if pairs else set()


@given(known_differences())
def test_two_share_a_letter_if_and_only_if_they_are_not_known_to_differ(drawn):
    count, differ = drawn
    letters = compact_letters(range(count), differ)
    for a in range(count):
        for b in range(a + 1, count):
            assert bool(set(letters[a]) & set(letters[b])) == (frozenset((a, b)) not in differ)


@given(known_differences())
def test_no_letter_is_redundant(drawn):
    count, differ = drawn
    letters = compact_letters(range(count), differ)
    names = sorted({letter for own in letters.values() for letter in own})
    groups = {name: {one for one in range(count) if name in letters[one]} for name in names}
    assert all(letters.values())
    assert not any(groups[a] <= groups[b] for a in names for b in names if a != b)


def played(policy, outcomes, tasks=("null/Reach",), **changes):
    rows = [
        {"pair_id": f"{task}-{seed}", "state_hash": "s", "task": task, "status": outcome, "severity": 0, **changes}
        for task in tasks
        for seed, outcome in enumerate(outcomes)
    ]
    frame = pd.DataFrame(rows, columns=list(COLUMNS)).assign(policy=policy, policy_digest=policy)
    return PolicyEpisodes(policy, policy, "run", 0.0, frame)


def test_policies_that_differ_clearly_get_other_letters_and_like_ones_the_same():
    good, bad = ["success"] * 40, ["failure"] * 40
    found = leaderboard([played("bad", bad), played("good", good), played("as-good", good)])
    assert {one.policy: one.letters for one in found} == {"good": "a", "as-good": "a", "bad": "b"}
    assert found[-1].policy == "bad"


def test_errors_and_perturbed_episodes_are_in_no_rate():
    mixed = played("mixed", ["success", "error", "failure", "success"])
    perturbed = played("mixed", ["failure"] * 4, severity=3)
    rows = pd.concat([mixed.rows, perturbed.rows])
    (found,) = leaderboard([PolicyEpisodes("mixed", "mixed", "run", 0.0, rows)])
    assert (found.successes, found.verdicts) == (2, 3)


@pytest.mark.parametrize("other", [{"tasks": ("null/B",)}, {"state_hash": "elsewhere"}])
def test_policies_without_an_episode_or_a_start_state_in_common_are_not_separated(other):
    found = leaderboard([played("a", ["success"] * 50), played("b", ["failure"] * 50, **other)])
    assert [one.letters for one in found] == ["a", "a"]


def test_only_tasks_that_all_have_played_count():
    hard = played("both", ["failure"] * 30, ("null/Hard",)).rows
    easy = played("both", ["success"] * 30, ("null/Easy",)).rows
    both = PolicyEpisodes("both", "both", "run", 0.0, pd.concat([hard, easy]))
    found = leaderboard([both, played("one", ["success"] * 30, ("null/Easy",))])
    assert {(one.rate, one.verdicts, one.letters) for one in found} == {(1.0, 30, "a")}


def test_a_rate_is_that_of_its_interval_where_tasks_have_unequal_episodes():
    hard = played("p", ["failure"] * 10, ("null/Hard",)).rows
    easy = played("p", ["success"] * 90, ("null/Easy",)).rows
    (found,) = leaderboard([PolicyEpisodes("p", "p", "run", 0.0, pd.concat([hard, easy]))])
    assert found.rate == 0.9
    assert found.interval == wilson_interval(90, 100)


VERSIONS = {"provenance": Provenance(packages={"mani-skill": "3.0.0"})}
NEWEST = {"provenance": Provenance(packages={"mani-skill": "3.0.1"}), "render_devices": {"null": "llvmpipe"}}


@pytest.mark.parametrize(
    ("earlier", "start", "reason"),
    [
        ({"success": "once"}, "s", "it counts success once, the newest run held"),
        (VERSIONS, "s", "simulator differs from the newest run: mani-skill 3.0.0, now 3.0.1"),
        (
            {"render_devices": {"null": "GPU"}},
            "s",
            "renderer differs from the newest run: null rendered on GPU, now on ",
        ),
        ({}, "t", "world differs from the newest run: another physical state at the start of 4 of 4 pairs"),
        ({}, "s", None),
    ],
)
def test_runs_that_are_not_comparable_with_the_newest_are_left_out_with_the_reason(tmp_path, earlier, start, reason):
    messages, of = [], cells(("p", "q"), ("null/Reach",))
    runs = [("old", {**NEWEST, **earlier}, of, start), ("new", NEWEST, of[:1], "s")]
    with closing(History.open(file_url(tmp_path / "history.sqlite"))) as history:
        for day, (name, changes, own, state) in enumerate(runs):
            rule = SuccessRule(changes.get("success", "held"))
            plan = [replace(cell, protocol=replace(cell.protocol, success=rule)) for cell in own]
            run = document(4, plan, run_id=name, started_at=1e9 + day, **changes)
            results = [row(cell, seed, state_hash=f"{state}{seed}") for cell in plan for seed in range(4)]
            record_run_folder(history, run_folder(tmp_path / name, run, results), run)
        found = list(latest_results_per_policy(history, "synthetic", messages.append))
    assert [(one.policy, one.run) for one in found] == [("p", "new"), *([] if reason else [("q", "old")])]
    assert [one.startswith(f"old is left out: {reason}") for one in messages] == ([True] if reason else [])


def test_without_rates_the_leaderboard_is_empty():
    assert leaderboard([]) == []
    assert leaderboard([played("none", ["error"] * 3)]) == []


def test_letters_that_would_grow_without_end_are_left_out():
    trios = [range(3 * i, 3 * i + 3) for i in range(12)]
    differ = {frozenset(pair) for trio in trios for pair in combinations(trio, 2)}
    letters = compact_letters(range(36), differ)
    assert set(letters.values()) == {"left out: more than 100 letters"}
