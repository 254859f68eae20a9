"""`python -m tests.chaos`: many runs under faults, each compared with one that was left alone."""

from __future__ import annotations

import argparse
import signal
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from tests.chaos.campaign import Survived, campaign, drawn_faults
from tests.chaos.suites import NULL, REAL


def main(arguments: Sequence[str] | None = None) -> int:
    """Run campaigns and print a line for each; the exit code is the number of those in which something was wrong."""
    parser = argparse.ArgumentParser(prog="python -m tests.chaos", description=__doc__)
    parser.add_argument("--runs", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0, help="of the first run; the next ones follow")
    parser.add_argument("--faults", type=int, default=4, help="faults in each run")
    parser.add_argument("--gap", type=float, default=2.0, help="mean seconds between two faults")
    parser.add_argument("--real", action="store_true", help="three real simulators instead of the null one")
    given = parser.parse_args(arguments)
    signal.signal(signal.SIGINT, signal.default_int_handler)  # else a campaign in the background cannot interrupt
    bad = 0
    with tempfile.TemporaryDirectory() as scratch:
        suite = Path(scratch) / "suite.yaml"
        suite.write_text(REAL if given.real else NULL)
        alone = campaign(suite, Path(scratch) / "alone", given.seed, faults=(), gap_s=1.0)
        print(_line("left alone", alone, alone.rows_hash), flush=True)
        for seed in range(given.seed, given.seed + given.runs):
            faults = drawn_faults(seed, given.faults)
            survived = campaign(suite, Path(scratch) / f"run{seed}", seed, faults=faults, gap_s=given.gap)
            print(_line(f"seed {seed}", survived, alone.rows_hash), flush=True)
            bad += bool(survived.problems) or survived.rows_hash != alone.rows_hash
    print(f"{given.runs - bad} of {given.runs} runs under faults ended complete with the rows of the one left alone")
    return bad


def _line(name: str, survived: Survived, expected: str | None) -> str:
    same = "same rows" if survived.rows_hash == expected else f"OTHER ROWS ({survived.rows_hash})"
    said = f"{name}: {survived.seconds:.0f} s, {survived.starts} starts, {same}; {', '.join(survived.faults) or 'none'}"
    return said + "".join(f"\n  PROBLEM: {problem}" for problem in survived.problems)


if __name__ == "__main__":
    sys.exit(main())
