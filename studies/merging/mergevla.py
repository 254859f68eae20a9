"""The suite `mergevla`: success and router accuracy by task, and the success lost by merging and by routing."""

import tempfile
from pathlib import Path

from robogauntlet.results.report import write_report
from robogauntlet.results.report.parquet import read_frame
from robogauntlet_mergevla.report.section import comparison_table, overall_table
from studies.shared import run_suite, table_of
from studies.tables import write_episodes

LOSSES = {"loss by merging": "loss by merging, points", "loss by routing": "loss by routing, points"}
LOSSES |= {"retention": "share of the experts' success"}
EPISODE = ["policy", "task", "seed", "status", "inferred_task"]


def measure() -> list[dict[str, object]]:
    """Rates with Wilson intervals of every task and simulator and of all, then the losses of each routed policy.

    Writes the episodes beside the rows.
    """
    with tempfile.TemporaryDirectory() as name:
        run_suite("mergevla", folder := Path(name) / "run")
        report = write_report(folder)
        frame = read_frame(report.paths.episodes, EPISODE)
    merging = report.data["merging"]
    routers = {one.policy: one.router for one in report.data["routing"]}
    write_episodes("mergevla", frame[EPISODE], EPISODE[:3])
    policies = [comparison.policy for comparison in merging.routed]
    names = ["task", merging.expert, merging.oracle_routed]
    for policy in policies:
        names += [policy, f"router of {policy}"]
    rows = [dict[str, object](zip(names, line, strict=True)) for line in comparison_table(merging, routers).rows]
    for loss, *values in overall_table(merging).rows:
        if loss in LOSSES:
            rows.append(dict.fromkeys(names, "") | {"task": LOSSES[loss]} | dict(zip(policies, values, strict=True)))
    table_of(rows, {name: f"{{{name}}}" for name in names})
    return rows
