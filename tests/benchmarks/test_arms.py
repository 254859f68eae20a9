"""What the pages say of experts, of arms and of the SO-101 is counted in the committed rows."""

import json

import pandas as pd
import pytest

from robogauntlet.results.statistics.rates import wilson_interval
from tests import ROOT
from tests.benchmarks import arms, doors, so101, stacking, two_arms
from tests.benchmarks.document import MEASUREMENTS
from tests.benchmarks.operators import percent


@pytest.mark.parametrize(
    "benchmark", [arms, doors, so101, stacking, two_arms], ids=lambda module: module.__name__.split(".")[-1]
)
def test_the_table_counts_the_committed_episodes(benchmark):
    name = benchmark.__name__.split(".")[-1]
    rows = json.loads((MEASUREMENTS / f"{name}.json").read_text(encoding="utf-8"))["rows"]
    assert benchmark.rows_of(pd.read_parquet(MEASUREMENTS / f"{name}.parquet")) == rows


def test_what_the_page_says_of_the_so101_beside_the_table_is_counted_in_its_rows():
    rows = pd.read_parquet(MEASUREMENTS / "so101.parquet")
    oracle, experts = (rows[rows.policy == policy] for policy in ("oracle", "experts"))
    assert ((oracle.status == "success").sum(), len(oracle)) == (586, 600)
    trained = experts[experts.task.isin(so101.TASKS)]
    assert (trained.status == "failure").sum() == 18
    assert (trained.failure == "misplaced").sum() == 14
    others = experts[~experts.task.isin(so101.TASKS)]
    assert others[others.status == "success"].task.tolist() == ["so101/Push-other-colours"] * 2
    assert set(others[others.task == "so101/PickPlace-other-colours"].failure) == {"not-grasped"}
    ties = rows[(rows.policy == "ties-s") & (rows.status == "success")]
    assert (len(ties), (trained.status == "success").sum()) == (1, 42)


def test_what_the_page_says_of_two_arms_beside_the_table_is_counted_in_its_rows():
    rows = pd.read_parquet(MEASUREMENTS / "two_arms.parquet")
    handed = rows[(rows.policy == "experts") & (rows.task == two_arms.TASKS[1])]
    assert handed.status.value_counts().to_dict() == {"failure": 38, "success": 12}
    assert (handed.failure == "misplaced").sum() == 33
    unlabelled = rows[(rows.policy == "magnitude-2-self-trained") & (rows.task == two_arms.TASKS[3])]
    assert (unlabelled.inferred_task == two_arms.TASKS[1]).sum() == 42


def test_what_the_page_says_of_doors_beside_the_table_is_counted_in_its_rows():
    rows = pd.read_parquet(MEASUREMENTS / "doors.parquet")
    failed = rows[rows.status == "failure"].groupby("failure").task
    counts = {kind: tasks.str.partition("@")[2].value_counts().to_dict() for kind, tasks in failed}
    assert counts == {"misplaced": {"Jaco": 8, "Kinova3": 4, "IIWA": 1}, "not-reached": {"XArm7": 1}}


def test_what_the_page_says_of_arms_beside_the_table_is_counted_in_its_rows():
    rows = pd.read_parquet(MEASUREMENTS / "arms.parquet")
    page = (ROOT / "docs/mergevla.md").read_text(encoding="utf-8")
    failures = rows[(rows.policy == "experts") & (rows.task == "robosuite/Door@Kinova3") & (rows.status == "failure")]
    assert failures.failure.tolist() == ["misplaced"] * 12  # of 50, as docs/robosuite.md says beside its table
    won = rows[rows.status == "success"].groupby(["setting", "policy"]).size()
    merges = {way: won["one skill", way] for way in arms.MERGES if way not in ("none-4", "naive-mean")}
    assert merges.pop("ties-s") == 194
    assert set(merges.values()) == {198, 199}
    assert won["one skill", "naive-mean"] == 129
    routed = rows[rows.policy == "ta-s-averaged-trunk-paper-coded"]
    same_hand = routed[(routed.setting == "one skill") & (routed.task != "robosuite/Lift@UR5e")]
    assert ((same_hand.inferred_task == "robosuite/Lift@IIWA").sum(), len(same_hand)) == (144, 150)
    assert f"{(same_hand.status == 'success').mean():.0%}" == "92%"
    lifted = routed[(routed.setting == "unseen arms") & (routed.status == "success")]
    assert lifted.task.value_counts().to_dict() == {"robosuite/Lift@Jaco": 17, "robosuite/Lift@XArm7": 8}
    assert set(lifted.inferred_task) == {"robosuite/Lift@IIWA"}
    own = rows[(rows.policy == "expert-of-IIWA") & (rows.setting == "unseen arms") & (rows.status == "success")]
    assert own.task.value_counts().tolist() == [2, 1]
    first, now = (
        {(row["setting"], row["policy"]): row["kept"] for row in arms.rows_of(table)}
        for table in (pd.read_parquet(MEASUREMENTS / "arms_first.parquet"), rows)
    )
    assert {first["unseen arms", way] for way in arms.ROUTED} == {"0 %"}
    kept = [first["three skills", way] for way in ("ties-s", "ta-s", "naive-mean")]
    said = " ".join(page.split())
    assert f"TIES+S kept {kept[0]}, TA+S {kept[1]} and the mean of everything {kept[2]}, which keeps" in said
    assert f"which keeps {now['three skills', 'naive-mean']} now" in said
    assert (
        f"TIES+S keeps {now['three skills', 'ties-s']} of the experts' success, TA+S {now['three skills', 'ta-s']},"
        in said
    )


def test_what_the_page_says_of_other_trainings_is_in_the_rows():
    rows = json.loads((MEASUREMENTS / "stacking.json").read_text(encoding="utf-8"))["rows"]
    found = {(row["task"].partition("/")[2], row["policy"]): row for row in rows}
    page = (ROOT / "docs/mergevla.md").read_text(encoding="utf-8")
    rates = [found[task, stacking.FEWER]["success"].partition(" %")[0] for task in ("Stack", "StackCube-v1")]
    assert (
        f"With 700 and 500 demonstrations the experts of these two tasks succeed in {rates[0]} and {rates[1]} %."
        in page
    )
    for task in ("Stack", "StackCube-v1"):
        more = found[task, stacking.SHIPPED]
        rate, apart = more["success"].partition(" [")[0], more["apart"].replace(" [", " points [")
        assert f"{task.removesuffix('-v1')} has {rate}** ({apart})" in page
    others = pd.read_parquet(MEASUREMENTS / "stacking_other_seeds.parquet")
    assert (others.seed.min(), others.seed.max(), set(others.policy)) == (100, 299, {stacking.SHIPPED})
    rates = [
        percent(won.mean(), wilson_interval(int(won.sum()), len(won)))
        for _, won in others.status.eq("success").groupby(others.task)
    ]
    assert f"Stack has {rates[1]} and StackCube {rates[0]} (" in page
    assert f"on 200 other seeds Stack's has [{rates[1].partition(' [')[0]}](" in page
    assert found["Stack", "corrected"]["apart"] == "-16 [-27, -5]"
    assert "16 points [5, 27] of Stack" in page
    assert found["StackCube-v1", "corrected-slowly"]["apart"] == "-10 [-19, -1]"
    assert "10 [1, 19] of StackCube" in page
    assert found["Stack", "executes-2"]["apart"] == "-17 [-25, -9]"
    assert "Stack loses 17 points [9, 25]" in page
    assert f"({found['Stack', 'longer']['apart'].replace(' [', ' points [')})" in page
    slowly = found["StackCube-v1", "slowly"]
    rate, apart = slowly["success"].partition(" [")[0], slowly["apart"].replace(" [", " points [")
    assert f"it has {rate} ({apart})" in page
    episodes = pd.read_parquet(MEASUREMENTS / "stacking.parquet")
    cubes = episodes[episodes.task == "maniskill/StackCube-v1"]
    assert cubes[cubes.policy == "corrected"].failure.tolist() == ["not-reached"] * 100

    def apart(task, policy, other):
        """Difference of two experts on the same episodes (points)."""
        played = episodes[(episodes.task == task) & episodes.policy.isin([policy, other])]
        rest = episodes[episodes.task != task]
        rows = stacking.rows_of(pd.concat([rest, played.replace({"policy": {other: stacking.FEWER}})]))
        return next(row["apart"] for row in rows if (row["task"], row["policy"]) == (task, policy))

    cube = "maniskill/StackCube-v1"
    assert apart(cube, "slowly", "corrected-slowly") == "+15 [+6, +24]"
    assert "without them has 15 points more [6, 24]" in page
    assert apart("robosuite/Stack", stacking.SHIPPED, "longer") == "+12 [+4, +20]"
    assert "the expert from 2,000 has 12 points more [4, 20] than with those" in page
    assert apart(cube, stacking.SHIPPED, "slowly") == "+5 [-1, +12]"
    assert "the expert from 2,000 has 5 points more [-1, 12] than with it" in page
    suite = pd.read_parquet(MEASUREMENTS / "mergevla.parquet")
    for (task, policy), played in episodes.groupby(["task", "policy"]):
        if policy == stacking.SHIPPED:
            again = suite[(suite.task == task) & (suite.policy == "experts")].set_index("seed").status.astype(str)
            assert played.set_index("seed").status.equals(again[played.seed])
