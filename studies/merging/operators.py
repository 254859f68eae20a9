"""Every way of merging beside the experts' quantised copies: bytes per task against success, at equal precision.

The suite `operators` in the weights' own types, and its merges again with all that they store at 8, 4 and 3 bits.
`RUN=FOLDER QUANTISED=FOLDER python -m studies merging --measure operators` reads a run of the suite, or several of
different seeds separated by colons, and plays the merges with few bits into a folder, or what it lacks of them.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
import yaml

from robogauntlet.adapters.contract import FloatArray
from robogauntlet.results.api import open_run
from robogauntlet.results.statistics.pairs import Pairs, paired_ratio
from robogauntlet.results.statistics.rates import Interval, wilson_interval
from studies.merging import bytes_plot
from studies.merging.bytes_plot import Point
from studies.percent import folder_of
from studies.shared import kilobytes, play_policies, run_suite, table_of
from studies.tables import WRITTEN, episodes_of, write_episodes

EXPERTS, JOINT, UNMERGED = "experts", "joint", "none"
COPIES = "copies, not merged"
BITS, FEWEST = (8, 4, 3), 2
"""Bits per entry of merges and copies, and of copies alone."""
SEEDS = 20
DRAWN = {
    "signs-2": bytes_plot.SHARED,
    "signs-1": bytes_plot.SHARED,
    "flat-2": bytes_plot.NOTHING_SHARED,
    "flat-1": bytes_plot.NOTHING_SHARED,
}
"""Ways to what they are in the plot; all others merge task vectors."""
EPISODE = ("policy", "task", "seed", "status")
COLUMNS = {
    "way": "{way}",
    "own types": "{own}",
    **{f"{bits} bits": f"{{bits_{bits}}}" for bits in (*BITS, FEWEST)},
}
SUITE = yaml.safe_load(Path(__file__).with_name("operators.yaml").read_text(encoding="utf-8"))
OTHERS = (EXPERTS, JOINT, UNMERGED)
WAYS = {one["name"]: one for one in SUITE["policies"] if one["name"].partition("-")[0] not in OTHERS}
"""Ways of merging, which are played with few bits, too."""


def measure() -> list[dict[str, Any]]:
    """A row for each way; writes the episodes and the figure beside the rows."""
    own, sizes = played()
    folder = folder_of("QUANTISED", "quantised")
    frames = [own]
    for bits in BITS:
        policies = {named(way, bits): at(WAYS[way], bits) for way in WAYS}
        frames.append(play_policies(folder, f"{bits} bits", policies, SUITE["tasks"], SEEDS, EPISODE))
        sizes |= {name: kilobytes_per_task(one["kind"], one["options"], flat(name)) for name, one in policies.items()}
    frame = pd.concat(frames)
    write_episodes("operators", frame, ("policy", "task", "seed"))
    rows = rows_of(frame, sizes)
    draw(rows, WRITTEN / "operators.svg")
    table_of(rows, COLUMNS)
    return rows


def counted(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The rows again, from the kept episodes; sizes are taken from the rows."""
    sizes = {name: point["kilobytes"] for row in rows for name, point in row["points"].items()}
    return rows_of(episodes_of("merging", "operators"), sizes)


def played() -> tuple[pd.DataFrame, dict[str, float]]:
    """Play the suite, or read `RUN`: its episodes, and each policy's storage per task beside the base (kB)."""
    with tempfile.TemporaryDirectory() as name:
        folders = [Path(folder) for folder in os.environ.get("RUN", f"{name}/run").split(":")]
        if "RUN" not in os.environ:
            run_suite(Path(__file__).with_name("operators.yaml"), folders[0])
        runs = [open_run(folder) for folder in folders]
        frame = pd.concat([run.episodes(EPISODE) for run in runs])
        plan = {policy.name: policy for policy in runs[0].document.suite.policies}
        return frame, {name: kilobytes_per_task(one.kind, one.options, flat(name)) for name, one in plan.items()}


def named(way: str, bits: int) -> str:
    """The policy of a way with few bits."""
    return f"{way}-{bits}" if way == UNMERGED else f"{way}-{bits}-bits"


def at(one: Mapping[str, Any], bits: int) -> dict[str, Any]:
    """A policy of the suite with all that it stores at `bits` bits."""
    options = {**one["options"], "recipe": {**one["options"]["recipe"], "bits": bits}}
    return {"kind": one["kind"], "options": options}


def flat(name: str) -> bool:
    """Whether all entries of a row of the merged vector are alike, so that the row's scale is all of it."""
    return name.startswith("flat")


def rows_of(frame: pd.DataFrame, sizes: Mapping[str, float]) -> list[dict[str, Any]]:
    """A row for each way: its share of the experts' success and kB per task, in its own types and with few bits.

    Args:
        frame: A row per episode: policy, task, seed, status.
        sizes: Policy to its storage per task beside the base.
    """
    table = outcomes_of(frame)
    rows = []
    bits_of = {UNMERGED: (*BITS, FEWEST), **dict.fromkeys(WAYS, BITS), JOINT: ()}
    for way, all_bits in bits_of.items():
        names = {bits: named(way, bits) for bits in all_bits}
        first = EXPERTS if way == UNMERGED else way
        points = {name: point(table, name, sizes[name]) for name in (first, *names.values())}
        row: dict[str, Any] = {"way": COPIES if way == UNMERGED else way, "points": points}
        row["own"] = cell(points[first])
        row |= {f"bits_{bits}": cell(points[names[bits]]) if bits in names else "" for bits in (*BITS, FEWEST)}
        rows.append(row)
    return rows


def outcomes_of(frame: pd.DataFrame) -> pd.DataFrame:
    """Success, 1 or 0, by task and seed (rows) and policy (columns)."""
    won = frame.assign(won=frame["status"].map({"success": 1.0, "failure": 0.0}))
    return won.pivot_table("won", ["task", "seed"], "policy")


def point(table: pd.DataFrame, policy: str, size: float) -> dict[str, Any]:
    """Successes, episodes, share of the experts' success with its score interval, and kB per task."""
    pairs = table[[policy, EXPERTS]].dropna() if policy != EXPERTS else table[[EXPERTS]].dropna()
    own = table[policy].dropna()
    found = {"kilobytes": size, "successes": int(own.sum()), "episodes": len(own), "kept": "100 %"}
    if policy != EXPERTS:
        found["kept"] = kept_of(*pairs.to_numpy().T)
    return found


def cell(found: Mapping[str, Any]) -> str:
    """A point as the table has it."""
    return f"{found['kept']}, {found['kilobytes']:,.0f} kB"


def percent(value: float, interval: Interval | None) -> str:
    """A share with its interval, in percent."""
    ends = f" [{100 * interval.low:.0f}, {100 * interval.high:.0f}]" if interval else ""
    return f"{100 * value:.0f} %{ends}"


def kept_of(own: FloatArray, experts: FloatArray) -> str:
    """Share of the experts' success on the same trials with its interval, in percent; empty where they have none."""
    ratio = paired_ratio(Pairs.from_outcomes(own, experts))
    return "" if ratio is None else percent(ratio.value, ratio.interval)


def kilobytes_per_task(
    kind: str, options: Mapping[str, Any], rows_alike: bool = False, experts: str = "zoo:experts"
) -> float:
    """Storage per expert beside the base, as checkpoints store it, without routers (kB).

    With `rows_alike` the merged vectors are left out: the scales of their rows are all of them.
    """
    from robogauntlet_mergevla.checkpoints.expert_checkpoint import read_tensors
    from robogauntlet_mergevla.checkpoints.merge_experts import merge_parts, read_experts
    from robogauntlet_mergevla.checkpoints.merged_checkpoint import tensors_of_parts
    from robogauntlet_mergevla.checkpoints.metadata import WEIGHTS
    from robogauntlet_mergevla.merging.recipe import Recipe
    from robogauntlet_mergevla.options import expert_folders
    from robogauntlet_mergevla.zoo import shipped

    if kind == "mergevla":
        return 0.0
    folders = sorted(set(expert_folders(shipped(experts)).values()))
    if kind == "mergevla-experts":
        return sum(kilobytes(read_tensors(folder / WEIGHTS)) for folder in folders) / len(folders)
    stored = tensors_of_parts(merge_parts(read_experts(folders), Recipe.from_json(options["recipe"])))
    vectors = ("tau/", "residual/tau/") if rows_alike else ()
    kept_here = {name: tensor for name, tensor in stored.items() if not name.startswith(vectors) or "scales/" in name}
    return kilobytes(kept_here if rows_alike else stored) / len(folders)


def draw(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Draw success with Wilson's intervals against storage per task, each way a line from its own types to 3 bits."""
    points = []
    for row in rows:
        kind = bytes_plot.NOT_MERGED if row["way"] == COPIES else DRAWN.get(row["way"], bytes_plot.MERGED)
        for place, found in enumerate(row["points"].values()):
            ends = wilson_interval(found["successes"], found["episodes"])
            assert ends is not None
            rate, interval = 100 * found["successes"] / found["episodes"], (100 * ends.low, 100 * ends.high)
            label = "" if place else row["way"]
            points.append(Point(label, kind, found["kilobytes"], rate, interval, row["way"]))
    (joint,) = (one.value for one in points if one.way == JOINT)
    shown = [one for one in points if one.way != JOINT]
    bytes_plot.draw(shown, path, measure="success, %", joint=joint, top=101)
