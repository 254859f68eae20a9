"""The suite `operators`: bytes per task against success, every way of merging a point, quantised experts as the bar.

`RUN=FOLDER python -m studies merging --measure operators` reads a run of the suite instead of playing all of its seeds;
several of different seeds are separated by colons.
"""

import os
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from robogauntlet.results.api import open_run
from robogauntlet.results.statistics.pairs import Pairs, paired_ratio
from robogauntlet.results.statistics.rates import Interval, wilson_interval
from studies.merging import bytes_plot
from studies.merging.bytes_plot import Point
from studies.shared import kilobytes, run_suite, table_of
from studies.tables import WRITTEN, episodes_of, write_episodes

EXPERTS, JOINT = "experts", "joint"
KINDS = {
    "experts": bytes_plot.NOT_MERGED,
    "none": bytes_plot.NOT_MERGED,
    "signs": bytes_plot.SHARED,
    "flat": bytes_plot.NOTHING_SHARED,
}
"""First part of a policy's name to what it is; all others merge task vectors."""
COLUMNS = {
    "way": "{policy}",
    "kB per task": "{kilobytes:,.0f}",
    "success": "{success}",
    "of the experts'": "{kept}",
    "weakest task": "{weakest}",
}


def measure() -> list[dict[str, object]]:
    """A row for each policy; writes the episodes and the figure beside the rows."""
    rows = measured("operators")
    draw(rows, WRITTEN / "operators.svg")
    return rows


def measured(suite: str) -> list[dict[str, object]]:
    """Play a suite of merges, or read `RUN`: a row for each policy; writes the episodes beside the rows."""
    with tempfile.TemporaryDirectory() as name:
        folders = [Path(folder) for folder in os.environ.get("RUN", f"{name}/run").split(":")]
        if "RUN" not in os.environ:
            run_suite(Path(__file__).with_name(f"{suite}.yaml"), folders[0])
        runs = [open_run(folder) for folder in folders]
        frame = pd.concat([run.episodes(("policy", "task", "seed", "status")) for run in runs])
        plan = {policy.name: policy for policy in runs[0].document.suite.policies}
        sizes = {name: kilobytes_per_task(policy.kind, policy.options) for name, policy in plan.items()}
    rows = rows_of(frame, sizes)
    write_episodes(suite, frame, ("policy", "task", "seed"))
    table_of(rows, COLUMNS)
    return rows


def counted(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, object]]:
    """The rows again, from the kept episodes."""
    return again("operators", rows)


def again(name: str, rows: Sequence[Mapping[str, Any]]) -> list[dict[str, object]]:
    """Rows of a table of merges from its kept episodes; sizes are taken from the rows."""
    return rows_of(episodes_of("merging", name), {row["policy"]: row["kilobytes"] for row in rows})


def rows_of(frame: pd.DataFrame, kilobytes: Mapping[str, float]) -> list[dict[str, object]]:
    """Success with Wilson's interval and the share of the experts' success with a score interval, most bytes first.

    Args:
        frame: A row per episode: policy, task, seed, status.
        kilobytes: Policy to its storage per task beside the base.
    """
    outcomes = frame["status"].map({"success": 1.0, "failure": 0.0})
    table = frame.assign(success=outcomes).pivot_table("success", ["task", "seed"], "policy")
    rows = []
    for policy in sorted(kilobytes, key=lambda name: -kilobytes[name]):
        own, experts = table[policy], table[EXPERTS]
        tasks = own.groupby("task", sort=True)
        interval = wilson_interval(int(own.sum()), int(own.count()))
        ratio = paired_ratio(Pairs.from_outcomes(own.to_numpy(), experts.to_numpy()))
        assert interval is not None
        assert ratio is not None
        rates = tasks.mean()
        rows.append(
            {
                "policy": policy,
                "kilobytes": kilobytes[policy],
                "successes": int(own.sum()),
                "episodes": int(own.count()),
                "success": percent(own.mean(), interval),
                "kept": "" if policy == EXPERTS else percent(ratio.value, ratio.interval),
                "weakest": f"{rates.idxmin()} {rates.min():.0%}".replace("%", " %"),
            }
        )
    return rows


def percent(value: float, interval: Interval | None) -> str:
    """A share with its interval, in percent."""
    ends = f" [{100 * interval.low:.0f}, {100 * interval.high:.0f}]" if interval else ""
    return f"{100 * value:.0f} %{ends}"


def kilobytes_per_task(kind: str, options: Mapping[str, Any]) -> float:
    """Storage per task beside the base, as checkpoints store it, without routers (kB)."""
    from robogauntlet_mergevla.checkpoints.expert_checkpoint import read_tensors
    from robogauntlet_mergevla.checkpoints.merge_experts import merge_parts, read_experts
    from robogauntlet_mergevla.checkpoints.merged_checkpoint import tensors_of_parts
    from robogauntlet_mergevla.checkpoints.metadata import WEIGHTS
    from robogauntlet_mergevla.merging.recipe import Recipe
    from robogauntlet_mergevla.options import expert_folders
    from robogauntlet_mergevla.zoo import shipped

    if kind == "mergevla":
        return 0.0
    folders = expert_folders(shipped("zoo:experts")).values()
    if kind == "mergevla-experts":
        return sum(kilobytes(read_tensors(folder / WEIGHTS)) for folder in folders) / len(folders)
    parts = merge_parts(read_experts(folders), Recipe.from_json(options["recipe"]))
    return kilobytes(tensors_of_parts(parts)) / len(folders)


def draw(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Draw success with Wilson's intervals against storage per task."""
    points = []
    for row in rows:
        rate, ends = row["successes"] / row["episodes"], wilson_interval(row["successes"], row["episodes"])
        assert ends is not None
        name = row["policy"]
        kind = KINDS.get(name.partition("-")[0], bytes_plot.MERGED)
        points.append(Point(name, kind, row["kilobytes"], 100 * rate, (100 * ends.low, 100 * ends.high)))
    (joint,) = (point.value for point in points if point.name == JOINT)
    shown = [point for point in points if point.name != JOINT]
    bytes_plot.draw(shown, path, measure="success, %", joint=joint, top=101)
