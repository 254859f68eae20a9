"""What the page says of robust experts and of merging under shift is counted in the committed rows."""

import json

import pandas as pd
import pytest

from tests import ROOT
from tests.benchmarks import equal_budget, merging_under_shift, robust_experts
from tests.benchmarks.document import MEASUREMENTS


def test_sentences_about_robust_experts_say_the_committed_rows():
    page = (ROOT / "docs/robustness.md").read_text(encoding="utf-8")
    measured = json.loads((MEASUREMENTS / "robust_experts.json").read_text(encoding="utf-8"))
    rows = {row["name"]: row for row in measured["rows"]}
    every, scenes, others = rows["all 18 axes"], rows["10 axes of the scenes"], rows["7 other axes"]
    costs = json.loads((MEASUREMENTS / "merging_under_shift.json").read_text(encoding="utf-8"))["rows"]
    both = {(row["policy"], row["experts"]): row for row in costs if row["where"] == "both severities"}
    merged, bits = (
        [both[policy, who] for who in merging_under_shift.SETTINGS] for policy in ("merged", "unmerged-int4")
    )
    assert [row["shown"] for row in (*merged, *bits)] == ["shown", "not shown", *["shown"] * 4]
    assert [rows["clean"][key] for key in ("zoo2", "robust2", "episodes")] == ["100%", "100%", "24"]
    for said in (
        f"{scenes['difference2']} points over its ten axes at severity 2 and {scenes['difference4']} at 4",
        f"at severity 2 the robust experts succeed in {every['robust2'][:-1]} %, the zoo's in {every['zoo2'][:-1]} %",
        f"is {rows['instruction (words)']['robust4'][:-1]} % instead of {rows['instruction (words)']['zoo4'][:-1]} %",
        f"no change is shown: {others['difference2']} and {others['difference4']}",
        *(
            f"({rows[axis]['robust4'][:-1]} %)"
            for axis in ("camera-bump (other)", "table", "robot-start", "object-position")
        ),
        f"({rows['action-noise (other)']['robust4'][:-1]} % of 8)",
        f"{merged[2]['lost']} in all nine tasks, {merged[0]['lost']} in the six",
        f"this is not shown: {merged[1]['lost']}",
        f"{bits[2]['lost']}, {bits[0]['lost']} and {bits[1]['lost']}",
    ):
        assert said in page
    readme = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    assert f"it loses {merged[2]['lost']} (90 % interval" in readme


def test_sentences_about_an_equal_budget_say_the_committed_rows():
    page = (ROOT / "docs/robustness.md").read_text(encoding="utf-8")
    measured = json.loads((MEASUREMENTS / "equal_budget.json").read_text(encoding="utf-8"))
    rows = {(row["task"], row["name"]): row for row in measured["rows"]}
    every = {task: rows[task, "all 18 axes"] for task in ("Stack", "StackCube-v1", "PandaPush-v3")}
    stack, *two = ({key: text[:-1] for key, text in row.items()} for row in every.values())
    robust, zoo = ([row[f"{family}2"] for row in two] for family in ("robust", "zoo"))
    clean = rows["all 3", "clean"]
    for said in (
        f"{rows['all 3', '10 axes of the scenes']['difference4']} points over the ten axes in the three tasks",
        f"Stack gains over all axes, too: {stack['robust4']} % instead of {stack['zoo4']} %",
        f"{clean['robust2'][:-1]} % of {clean['episodes']} clean episodes instead of {clean['zoo2'][:-1]} %",
        f"StackCube's {robust[0]} % and PandaPush's {robust[1]} % instead of {zoo[0]} % and {zoo[1]} %",
    ):
        assert said in page
    assert not every["Stack"]["difference4"].startswith("-")
    assert all(" [-" in every[task]["difference2"] for task in ("StackCube-v1", "PandaPush-v3"))


@pytest.mark.parametrize(
    ("name", "table", "episodes"),
    [
        ("robust_experts", robust_experts, "robust_experts"),
        ("merging_under_shift", merging_under_shift, "robust_experts"),
        ("equal_budget", equal_budget, "equal_budget"),
    ],
)
def test_tables_of_robust_experts_count_the_committed_episodes(name, table, episodes):
    rows = json.loads((MEASUREMENTS / f"{name}.json").read_text(encoding="utf-8"))["rows"]
    assert table.rows_of(pd.read_parquet(MEASUREMENTS / f"{episodes}.parquet")) == rows
