"""Rates of LIBERO's experts and of their merges."""

import pandas as pd

from tests.benchmarks import libero_experts, libero_merges

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


def test_a_merge_is_compared_with_the_experts_where_both_have_an_outcome():
    merges = {"none-4": ["success", "success", "error"]}
    rows = libero_merges.rows_of(frame(experts=["success", "error", "success"], **merges))
    kept = {row["policy"]: row["kept"] for row in rows}
    assert kept == {"experts": "", "none-4": "100 %"}
