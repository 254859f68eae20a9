"""`python -m tests.chaos`: many runs under faults, each compared with an undisturbed run."""

from __future__ import annotations

import argparse
import signal
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from tests.chaos.campaign import CampaignResult, draw_faults, run_campaign
from tests.chaos.suites import NULL, REAL


def main(arguments: Sequence[str] | None = None) -> int:
    """Run campaigns and print a line for each; the exit code is the number of campaigns with a problem."""
    parser = argparse.ArgumentParser(prog="python -m tests.chaos", description=__doc__)
    parser.add_argument("--runs", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0, help="seed of the first run; the next runs have the next seeds")
    parser.add_argument("--faults", type=int, default=4, help="faults in each run")
    parser.add_argument("--gap", type=float, default=2.0, help="mean seconds between two faults")
    parser.add_argument("--real", action="store_true", help="three real simulators instead of the null simulator")
    options = parser.parse_args(arguments)
    signal.signal(signal.SIGINT, signal.default_int_handler)  # otherwise a campaign in the background cannot interrupt
    bad = 0
    with tempfile.TemporaryDirectory() as scratch:
        suite = Path(scratch) / "suite.yaml"
        suite.write_text(REAL if options.real else NULL)
        undisturbed = run_campaign(suite, Path(scratch) / "undisturbed", options.seed, faults=(), gap_s=1.0)
        print(_line("undisturbed", undisturbed, undisturbed.rows_hash), flush=True)
        for seed in range(options.seed, options.seed + options.runs):
            faults = draw_faults(seed, options.faults)
            result = run_campaign(suite, Path(scratch) / f"run{seed}", seed, faults=faults, gap_s=options.gap)
            print(_line(f"seed {seed}", result, undisturbed.rows_hash), flush=True)
            bad += bool(result.problems) or result.rows_hash != undisturbed.rows_hash
    print(
        f"{options.runs - bad} of {options.runs} runs under faults are complete, with the rows of the undisturbed run"
    )
    return bad


def _line(name: str, result: CampaignResult, expected: str | None) -> str:
    same = "same rows" if result.rows_hash == expected else f"OTHER ROWS ({result.rows_hash})"
    line = f"{name}: {result.seconds:.0f} s, {result.starts} starts, {same}; {', '.join(result.faults) or 'none'}"
    return line + "".join(f"\n  PROBLEM: {problem}" for problem in result.problems)


if __name__ == "__main__":
    sys.exit(main())
