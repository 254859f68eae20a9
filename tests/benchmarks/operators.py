"""The suite `operators`: bytes per task against success, every way of merging a point, quantised experts as the bar.

`RUN=FOLDER python -m tests.benchmarks operators` reads a run of the suite instead of playing all of its seeds.
"""

import os
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from robogauntlet.results.api import open_run
from robogauntlet.results.report.figure_style import COLOURS, GRID, STYLE, new_figure
from robogauntlet.results.statistics.pairs import Pairs, paired_ratio
from robogauntlet.results.statistics.rates import Interval, wilson_interval
from tests.benchmarks.document import WRITTEN
from tests.benchmarks.shared import kilobytes, run_suite, table_of

EXPERTS, JOINT = "experts", "joint"
KINDS = {"none": "not merged", "signs": "signs, shared magnitudes", "flat": "signs, nothing shared"}
"""First part of a policy's name to what it is; all others merge task vectors."""
MERGED = "merged task vectors"
COLUMNS = {
    "way": "{policy}",
    "kB per task": "{kilobytes:,.0f}",
    "success": "{success}",
    "of the experts'": "{kept}",
    "weakest task": "{weakest}",
}


def measure() -> list[dict[str, object]]:
    """A row for each policy; writes the episodes and the figure beside the rows."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(os.environ.get("RUN", Path(name) / "run"))
        if "RUN" not in os.environ:
            run_suite("operators", folder)
        run = open_run(folder)
        frame = run.episodes(("policy", "task", "seed", "success", "steps"))
        plan = {policy.name: policy for policy in run.document.suite.policies}
        sizes = {name: kilobytes_per_task(policy.kind, policy.options) for name, policy in plan.items()}
    rows = rows_of(frame, sizes)
    frame.sort_values(["policy", "task", "seed"]).to_parquet(WRITTEN / "operators.parquet", index=False)
    draw(rows, WRITTEN / "operators.svg")
    table_of(rows, COLUMNS)
    return rows


def rows_of(frame: pd.DataFrame, kilobytes: Mapping[str, float]) -> list[dict[str, object]]:
    """Success with Wilson's interval and the share of the experts' success with a bootstrap interval, most bytes first.

    Args:
        frame: A row per episode: policy, task, seed, success.
        kilobytes: Policy to its storage per task beside the base.
    """
    table = frame.assign(success=frame["success"].astype(float)).pivot_table("success", ["task", "seed"], "policy")
    rows = []
    for policy in sorted(kilobytes, key=lambda name: -kilobytes[name]):
        own, experts = table[policy], table[EXPERTS]
        tasks = own.groupby("task", sort=True)
        interval = wilson_interval(int(own.sum()), int(own.count()))
        strata = [Pairs.from_outcomes(one.to_numpy(), experts.loc[[task]].to_numpy()) for task, one in tasks]
        ratio = paired_ratio(strata, np.random.default_rng(0))
        assert interval is not None
        assert ratio is not None
        rates = tasks.mean()
        rows.append(
            {
                "policy": policy,
                "kilobytes": kilobytes[policy],
                "successes": int(own.sum()),
                "episodes": int(own.count()),
                "success": _percent(own.mean(), interval),
                "kept": "" if policy == EXPERTS else _percent(ratio.value, ratio.interval),
                "weakest": f"{rates.idxmin()} {rates.min():.0%}".replace("%", " %"),
            }
        )
    return rows


def _percent(value: float, interval: Interval | None) -> str:
    ends = f" [{100 * interval.low:.0f}, {100 * interval.high:.0f}]" if interval else ""
    return f"{100 * value:.0f} %{ends}"


def kilobytes_per_task(kind: str, options: Mapping[str, Any]) -> float:
    """Storage per task beside the base, as checkpoints store it, without routers (kB)."""
    from robogauntlet.policies.mergevla.checkpoints.expert_checkpoint import read_tensors
    from robogauntlet.policies.mergevla.checkpoints.merge_experts import merge_parts, read_experts
    from robogauntlet.policies.mergevla.checkpoints.merged_checkpoint import tensors_of_parts
    from robogauntlet.policies.mergevla.checkpoints.metadata import WEIGHTS
    from robogauntlet.policies.mergevla.merging.recipe import Recipe
    from robogauntlet.policies.mergevla.options import expert_folders
    from robogauntlet.policies.zoo import shipped

    if kind == "mergevla":
        return 0.0
    folders = expert_folders(shipped("zoo:experts")).values()
    if kind == "mergevla-experts":
        return sum(kilobytes(read_tensors(folder / WEIGHTS)) for folder in folders) / len(folders)
    parts = merge_parts(read_experts(folders), Recipe.from_json(options["recipe"]))
    return kilobytes(tensors_of_parts(parts)) / len(folders)


def draw(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Draw success with intervals against bytes per task; a line joins what is not merged."""
    import matplotlib as mpl

    with mpl.rc_context(STYLE):
        figure, panels = new_figure(4.2)
        figure.set_figwidth(6.7)
        panel = panels[0, 0]
        for place, (name, kind) in enumerate([*KINDS.items(), ("", MERGED)]):
            shown = [row for row in rows if _kind(row["policy"]) == kind]
            x = [row["kilobytes"] for row in shown]
            y = [100 * row["successes"] / row["episodes"] for row in shown]
            ends = [wilson_interval(row["successes"], row["episodes"]) for row in shown]
            panel.vlines(x, [100 * end.low for end in ends], [100 * end.high for end in ends], colors=COLOURS[place])
            line = "-" if name == "none" else ""
            panel.plot(x, y, f"o{line}", color=COLOURS[place], markersize=3.5, linewidth=0.8, label=kind)
            for row, across, up in zip(shown, x, y, strict=True):
                panel.annotate(
                    row["policy"], (across, up), (3, 3), textcoords="offset points", fontsize=5.5, color=COLOURS[place]
                )
        for row in rows:
            if row["policy"] == JOINT:
                rate = 100 * row["successes"] / row["episodes"]
                panel.axhline(rate, color="#56748c", linestyle="--", linewidth=0.8, label="joint training, one network")
        panel.set_xscale("log")
        panel.set_ylim(0, 101)
        panel.set_xlabel("kB per task beside the base (nine tasks)")
        panel.set_ylabel("success, %")
        panel.grid(**GRID)
        panel.legend(frameon=False, loc="lower right")
        figure.savefig(path, metadata={"Date": None})


def _kind(policy: str) -> str | None:
    if policy == JOINT:
        return None
    return KINDS.get("none" if policy == EXPERTS else policy.partition("-")[0], MERGED)
