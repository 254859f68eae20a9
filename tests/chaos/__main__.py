"""`python -m tests.chaos [--cluster]`: many runs under faults, each compared with an undisturbed run on one machine.

Results are in `runs/bench/chaos.json` or `chaos_cluster.json` after every run; `--seed N` adds to those of other seeds.
`runs/chaos` keeps the folder and the log of each run with a problem.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import shutil
import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from studies.tables import WRITTEN, write
from tests.chaos.campaign import CampaignResult, draw_faults, run_campaign
from tests.chaos.cluster_nodes import why_not
from tests.chaos.places import OneMachine, three_nodes
from tests.chaos.suites import LONG, NULL, REAL

COLUMNS = {
    "fault": "{fault}",
    "times": "{times}",
    "runs": "{runs}",
    "complete, with the rows of an undisturbed run": "{complete}",
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run campaigns and print a line for each; the exit code is the number of campaigns with a problem."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.chaos", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=50)
    parser.add_argument(
        "--seed", type=int, default=0, help="seed of the first run; with 0, earlier results are dropped"
    )
    parser.add_argument("--faults", type=int, help="faults in each run (4; on a cluster 3)")
    parser.add_argument("--gap", type=float, default=2.0, help="mean seconds between two faults")
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--real", action="store_true", help="three real simulators instead of the null simulator")
    where.add_argument("--cluster", action="store_true", help="a Ray cluster of three nodes, in network namespaces")
    options = parser.parse_args(arguments)
    if options.cluster and (reason := why_not()) is not None:
        parser.error(reason)
    signal.signal(signal.SIGINT, signal.default_int_handler)  # otherwise a campaign in the background cannot interrupt
    name, text = "chaos", NULL
    if options.real:
        name, text = "chaos_real", REAL
    elif options.cluster:
        name, text = "chaos_cluster", LONG
    count = options.faults or (3 if options.cluster else 4)
    scratch = Path("runs/chaos").resolve() / name
    shutil.rmtree(scratch, ignore_errors=True)
    scratch.mkdir(parents=True)
    suite = scratch / "suite.yaml"
    suite.write_text(text)
    undisturbed = run_campaign(suite, scratch / "undisturbed", options.seed, faults=(), gap_s=1.0)
    print(_line("undisturbed", undisturbed, undisturbed.rows_hash), flush=True)
    seeds = range(options.seed, options.seed + options.runs)
    campaigns = [row for row in _earlier(name) if options.seed and row["seed"] not in seeds]
    with three_nodes(scratch) if options.cluster else contextlib.nullcontext(OneMachine()) as place:
        for seed in seeds:
            folder, faults = scratch / f"run{seed}", draw_faults(seed, count, place.faults)
            result = run_campaign(suite, folder, seed, faults=faults, gap_s=options.gap, place=place)
            print(_line(f"seed {seed}", result, undisturbed.rows_hash), flush=True)
            latest = _row(seed, result, undisturbed.rows_hash)
            campaigns = sorted([*campaigns, latest], key=lambda row: row["seed"])
            command = f"python -m tests.chaos{' --cluster' * options.cluster}{' --real' * options.real}"
            write(name, {"command": command, "columns": COLUMNS, "rows": table(campaigns), "campaigns": campaigns})
            if _is_good(latest):
                shutil.rmtree(folder)
    good = sum(map(_is_good, campaigns))
    print(f"{good} of {len(campaigns)} runs under faults are complete, with the rows of the undisturbed run")
    return len(campaigns) - good


def table(campaigns: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """A row for each kind of fault, and one for all."""
    kinds = sorted({fault for campaign in campaigns for fault in campaign["faults"]})
    rows = []
    for kind in (*kinds, "all"):
        hit = [campaign for campaign in campaigns if kind == "all" or kind in campaign["faults"]]
        times = sum(kind in ("all", fault) for campaign in hit for fault in campaign["faults"])
        rows.append({"fault": kind, "times": times, "runs": len(hit), "complete": sum(map(_is_good, hit))})
    return rows


def _earlier(name: str) -> list[dict[str, Any]]:
    file = WRITTEN / f"{name}.json"
    return json.loads(file.read_text(encoding="utf-8"))["campaigns"] if file.exists() else []


def _row(seed: int, result: CampaignResult, expected: str | None) -> dict[str, Any]:
    same = result.rows_hash is not None and result.rows_hash == expected
    measured = {"faults": list(result.faults), "starts": result.starts, "seconds": round(result.seconds, 1)}
    return {"seed": seed, **measured, "same_rows": same, "problems": list(result.problems)}


def _is_good(campaign: dict[str, Any]) -> bool:
    return campaign["same_rows"] and not campaign["problems"]


def _line(name: str, result: CampaignResult, expected: str | None) -> str:
    same = "same rows" if result.rows_hash == expected else f"OTHER ROWS ({result.rows_hash})"
    line = f"{name}: {result.seconds:.0f} s, {result.starts} starts, {same}; {', '.join(result.faults) or 'none'}"
    return line + "".join(f"\n  PROBLEM: {problem}" for problem in result.problems)


if __name__ == "__main__":
    sys.exit(main())
