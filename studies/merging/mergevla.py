"""The suite `mergevla`: success and router accuracy by task, and the success lost by merging and by routing."""

import tempfile
from pathlib import Path

from robogauntlet.results.analysis import merging_cost
from robogauntlet.results.report import ReportPaths
from robogauntlet.results.report.merging_cost import comparison_table, overall_table
from robogauntlet.results.report.parquet import read_frame
from robogauntlet.results.run_document import read_run
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
        frame = read_frame(ReportPaths.in_folder(folder).episodes, (*merging_cost.COLUMNS, "policy", "seed"))
        merging = merging_cost.build_merging(read_run(folder), frame)
    assert merging is not None
    write_episodes("mergevla", frame[EPISODE], EPISODE[:3])
    policies = [comparison.policy for comparison in merging.routed]
    names = ["task", merging.expert, merging.oracle_routed]
    for policy in policies:
        names += [policy, f"router of {policy}"]
    rows = [dict[str, object](zip(names, line, strict=True)) for line in comparison_table(merging).rows]
    for loss, *values in overall_table(merging).rows:
        if loss in LOSSES:
            rows.append(dict.fromkeys(names, "") | {"task": LOSSES[loss]} | dict(zip(policies, values, strict=True)))
    table_of(rows, {name: f"{{{name}}}" for name in names})
    return rows
