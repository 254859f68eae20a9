"""Tests of results/analysis/leaderboard.py."""

from contextlib import closing
from dataclasses import replace
from itertools import combinations
from operator import attrgetter
from random import Random

import pandas as pd
import pytest
from hypothesis import given, strategies as st

from robogauntlet.results.analysis.comparison import Difference, setting_differences
from robogauntlet.results.analysis.leaderboard import COLUMNS, PolicyEpisodes, compact_letters, leaderboard
from robogauntlet.results.newest_results import latest_results_per_policy
from robogauntlet.results.run_document import Provenance
from robogauntlet.results.statistics.rates import wilson_interval
from robogauntlet.results.store.database import file_url
from robogauntlet.results.store.history_import import record_run_folder
from robogauntlet.results.store.run_history import History
from robogauntlet.suites.episode import Condition, SuccessRule, content_hash
from tests.results.synthetic import cells, columns_of, document, row, run_folder


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


@pytest.mark.parametrize("seed", range(20))
def test_what_is_read_of_runs_gives_the_leaderboard_of_all_their_rows(tmp_path, seed):
    plan = cells(("p", "q", "r"), ("null/Reach", "null/Lift"), (Condition(), Condition("blur", 2)))
    generator, messages, stored = Random(seed), [], []
    with closing(History.open(file_url(tmp_path / "history.sqlite"))) as history:
        for day in range(4):
            states = generator.choice(["s", "s", "s", "st", ["s", ""]])
            of = [cell for cell in plan if generator.random() < 0.6]
            rows = [_drawn(generator, cell, number, states) for cell in of for number in range(4)]
            run = document(4, plan, run_id=f"run-{day}", started_at=1e9 + day)
            record_run_folder(history, run_folder(tmp_path / run.run_id, run, rows), run)
            stored.insert(0, (run, columns_of(sorted(rows, key=lambda one: one.policy), COLUMNS)))
        found = list(latest_results_per_policy(history, "synthetic", messages.append))
    expected, reasons, first = {}, [], stored[0]
    for run, rows in stored:
        wanted = {"p", "q", "r"} - expected.keys()
        sides = [one[one["status"] != "error"].drop_duplicates("pair_id") for one in (first[1], rows)]
        why = setting_differences(first[0], run, sides[0].merge(sides[1], on="pair_id", suffixes=("", "_before")))
        reasons += [why[Difference.WORLD]] if why and wanted else []
        own = {} if why else {name: rows[rows["policy"] == name] for name in sorted(wanted & set(rows["policy"]))}
        expected |= {n: PolicyEpisodes(n, content_hash(n), run.run_id, run.started_at, of) for n, of in own.items()}
    assert [one.partition("newest run: ")[2] for one in messages] == reasons
    assert leaderboard(sorted(found, key=attrgetter("policy"))) == leaderboard([expected[n] for n in sorted(expected)])


def _drawn(generator, cell, number, states):
    status = generator.choice(["success", "failure", "error"])
    return row(cell, number, status, **({} if status == "error" else {"state_hash": generator.choice(states)}))


def test_without_rates_the_leaderboard_is_empty():
    assert leaderboard([]) == []
    assert leaderboard([played("none", ["error"] * 3)]) == []


def test_letters_that_would_grow_without_end_are_left_out():
    trios = [range(3 * i, 3 * i + 3) for i in range(12)]
    differ = {frozenset(pair) for trio in trios for pair in combinations(trio, 2)}
    letters = compact_letters(range(36), differ)
    assert set(letters.values()) == {"left out: more than 100 letters"}
