"""Rates of LIBERO's experts and of their merges."""

import pandas as pd

from robogauntlet.adapters.libero_plus.variants import PlusAxis, variants
from tests.benchmarks import libero_experts, libero_merges, libero_plus

TASKS = {suite: f"libero/{suite}-0-a-task" for suite in libero_experts.SUITES}


def frame(**outcomes):
    """Episodes of policies, each with these outcomes in each suite, for the first seeds."""
    return pd.DataFrame(
        {"policy": policy, "axis": "clean", "task": task, "seed": seed, "status": status, "inferred_task": task}
        for policy, statuses in outcomes.items()
        for task in TASKS.values()
        for seed, status in enumerate(statuses)
    )


def test_an_error_counts_neither_as_success_nor_as_failure():
    (row,) = [
        row
        for row in libero_experts.rows_of(frame(experts=["success", "error", "failure"]))
        if (row["policy"], row["axis"]) == ("experts", "clean")
    ]
    assert row["Goal"] == "50 % [9, 91]"
    assert row["all"] == "50 % [22, 78]"


def test_more_states_are_runs_beside_those_that_were_played(monkeypatch, tmp_path):
    runs = []

    def play(folder, run, policies, tasks, seeds, columns, conditions, first):
        runs.append((run, first, seeds))
        return pd.DataFrame()

    monkeypatch.setattr(libero_experts, "play_policies", play)
    monkeypatch.setattr(libero_experts, "STATES", 15)
    libero_experts.played(tmp_path, "experts", {}, [], [])
    assert runs == [("experts", 0, 10), ("experts-from-10", 10, 5)]


def test_a_merge_is_compared_with_the_experts_where_both_have_an_outcome():
    merges = {"none-4": ["success", "success", "error"]}
    rows = libero_merges.rows_of(frame(experts=["success", "error", "success"], **merges))
    kept = {row["policy"]: row["kept"] for row in rows}
    assert kept == {"experts": "", "none-4": "100 %"}


def test_variants_are_evenly_spaced_among_those_that_liberos_assets_show():
    own = "libero/goal-7-turn-on-stove"
    chosen = libero_plus.sampled(PlusAxis.LAYOUT, [own], 2)
    shown = [one for one in variants() if one.task.startswith("layout-goal-7-") and "add" not in one.task]
    assert [shown.index(one) for one in chosen] == [len(shown) // 4, 3 * len(shown) // 4]


def test_an_axis_of_liberoplus_has_the_experts_their_merges_and_decisions():
    def episode(policy, axis, task, status, inferred=None):
        return {"policy": policy, "axis": axis, "task": task, "seed": 0, "status": status, "inferred_task": inferred}

    one, other = "libero-plus/robot-goal-7-448", "libero-plus/robot-goal-7-458"
    frame = pd.DataFrame(
        [
            *(episode("experts", "clean", task, "success") for task in (one, other)),
            *(episode("experts", libero_plus.NAMED, task, "failure") for task in (one, other)),
            episode("magnitude-2-routed", "clean", one, "success", one),
            episode("magnitude-2-routed", "clean", other, "failure", "libero-object"),
            *(episode("none-4", "clean", task, "success") for task in (one, other)),
        ]
    )
    robot, every = libero_plus.rows_of(frame)
    assert (robot["plus_axis"], every["plus_axis"]) == ("robot", "all")
    assert robot["experts"].startswith("100 %")
    assert robot["named"].startswith("0 %")
    assert every["named"] == ""
    assert robot["routed"] == "50 %"
    assert robot["kept"].startswith("50 %")
    assert robot["none-4-kept"] == "100 %"
