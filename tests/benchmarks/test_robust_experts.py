"""What the page says of robust experts, worst cases and merging under shift is counted in the committed rows."""

import json

import pandas as pd
import pytest

from tests import ROOT
from tests.benchmarks import boundaries, equal_budget, merging_under_shift, robust_experts
from tests.benchmarks.document import MEASUREMENTS


def test_the_boundaries_of_the_shipped_experts_are_those_of_the_committed_episodes():
    rows = json.loads((MEASUREMENTS / "boundaries.json").read_text(encoding="utf-8"))["rows"]
    assert boundaries.rows_of(pd.read_parquet(MEASUREMENTS / "boundaries.parquet")) == rows
    tested = {row["boundary"]: [row[task] for task in boundaries.TASKS] for row in rows if "tested" in row["boundary"]}
    confirmed = {what: [cell.endswith(", breaks") for cell in cells] for what, cells in tested.items()}
    assert confirmed["camera-bump, tested"] == [False, False, True]
    assert tested["camera-bump, tested"][2].startswith("camera-bump@4.7: ")
    page = (ROOT / "docs/robustness.md").read_text(encoding="utf-8")
    assert f"{sum(map(sum, confirmed.values()))} of {sum(map(len, confirmed.values()))} claims are confirmed" in page
    assert not any(cells[0] for cells in confirmed.values())


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


def test_sentences_about_an_equal_budget_say_the_committed_rows():
    page = (ROOT / "docs/robustness.md").read_text(encoding="utf-8")
    measured = json.loads((MEASUREMENTS / "equal_budget.json").read_text(encoding="utf-8"))
    rows = {(row["task"], row["name"]): row for row in measured["rows"]}
    every, scenes, others, clean = (
        rows[equal_budget.TOGETHER, name]
        for name in (robust_experts.EVERY, robust_experts.SCENES, robust_experts.OTHERS, "clean")
    )
    stack, stack_scenes = (rows["Stack", name] for name in (robust_experts.EVERY, robust_experts.SCENES))
    for said in (
        f"{scenes['difference4']} points over their ten axes, mostly in Stack ({stack_scenes['difference4']})",
        f"too: {stack['robust4'][:-1]} % instead of {stack['plain4'][:-1]} %",
        f"{others['difference4']} points at severity 4 along the seven axes",
        f"neither at severity 4 ({every['difference4']}) nor at 2 ({every['difference2']})",
        f"({clean['robust2'][:-1]} % of {clean['episodes']} instead of {clean['plain2'][:-1]} %)",
    ):
        assert said in page
    assert all(low(row) > 0 for row in (scenes, stack, stack_scenes))
    assert high(others) < 0
    assert all(low(row, severity) < 0 < high(row, severity) for row in (every, clean) for severity in (2, 4))
    played = pd.read_parquet(MEASUREMENTS / "equal_budget.parquet")
    cubes = played[(played.policy == "robust") & (played.task == "maniskill/StackCube-v1")]
    rates = (cubes.status == "success").groupby(cubes.seed).mean().sort_values()
    assert rates.iloc[1] < 0.25 < 0.85 < rates.iloc[2]


def low(row, severity=4):
    """Lower end of the interval of a difference (points)."""
    return float(row[f"difference{severity}"].partition("[")[2].partition(",")[0])


def high(row, severity=4):
    """Upper end of the interval of a difference (points)."""
    return float(row[f"difference{severity}"].partition(", ")[2].rstrip("]"))


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
