"""Measures a hundredth of every table, one after the other: `python -m studies.hundredth`, after `make environments`.

The training scripts make their experts first, at the same share. Says of each script and table whether it went through,
and after how many seconds; which could not be tried, since the machine lacks something; and how others ended.
"""

import os
import shutil
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Mapping, Sequence

from studies.percent import LACKING
from studies.tables import NAMES, ROOT, STUDIES

VARIABLES = {**os.environ, "PERCENT": "1", "ROBOGAUNTLET": f"{sys.prefix}/bin/robogauntlet", "OMP_NUM_THREADS": "1"}
PARTS = "runs/{}-1-percent"
SIX_TASKS = ("coffee-button", "handle-press", "plate-slide", "reach-wall", "button-press", "faucet-open")
SCRIPTS: Mapping[str, tuple[Sequence[str], Mapping[str, str]]] = {
    "arms/arms.sh": ((), {}),
    "two_arms/two_arms.sh": ((), {}),
    "so101/so101.sh": ((), {}),
    "more_experts/meta_world.sh": ((PARTS.format("meta-world"), *SIX_TASKS), {}),
    "libero/libero.sh": ((), {}),
    "merging/training_controls.sh": (
        (PARTS.format("training-controls"), "0"),
        {"KINDS": "cross-sigmoid cross-sigmoid-fresh joint"},
    ),
    "robust_experts/robust_experts.sh": ((), {"AXES": "table"}),
}
"""Script to its words and variables: fewer tasks, kinds of training and axes."""
SHOWN = {"DEMONSTRATIONS": f"{PARTS.format('training-controls')}/demonstrations"}
"""Variables of measurements: the demonstrations of nine tasks."""


def main() -> None:
    """Make the experts, and measure; exit code 1 if anything failed."""
    for folder in (ROOT / "runs").glob("*-1-percent"):
        shutil.rmtree(folder)
    ends: Counter[str] = Counter()
    for script, (words, variables) in SCRIPTS.items():
        ends[_run(script, ["bash", f"studies/{script}", *words], variables)] += 1
    for study in NAMES:
        for rows in sorted(STUDIES.glob(f"{study}/rows/*.json")):
            if (STUDIES / study / f"{rows.stem}.py").exists():
                command = [sys.executable, "-m", "studies", study, "--measure", rows.stem]
                ends[_run(f"{study} {rows.stem}", command, SHOWN)] += 1
    print(", ".join(f"{count} {end}" for end, count in ends.items()))
    sys.exit("failed" in ends)


def _run(name: str, command: Sequence[str], variables: Mapping[str, str]) -> str:
    began = time.monotonic()
    done = subprocess.run(command, cwd=ROOT, env={**VARIABLES, **variables}, capture_output=True, text=True)
    end = {0: "passed", LACKING: "left out"}.get(done.returncode, "failed")
    print(f"{end:9} {time.monotonic() - began:5.0f} s  {name}", flush=True)
    if end == "left out":
        print(f"          {done.stderr.strip()}", flush=True)
    elif end == "failed":
        print(done.stdout[-2000:], done.stderr[-4000:], sep="\n", flush=True)
    return end


if __name__ == "__main__":
    main()
