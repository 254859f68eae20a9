"""Ctrl-C and SIGTERM at every tenth of a second of a run's start."""

import signal
import subprocess
import time

import psutil
import pytest

from tests.processes import GAUNTLET, environment_of, started_by

pytestmark = [pytest.mark.ray, pytest.mark.chaos]

SUITE = "name: s\npolicies: [oracle]\ntasks: [null/Slow]\nseeds: {count: 500}\nworkers: 1\n"
LAST_S, STEP_S = 6.0, 0.1
ENDS_S = 2.0
"""Time in which an interrupted start ends, on a machine that is not busy (s)."""
GONE_S = 10.0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=lambda number: number.name)
def test_a_run_that_is_interrupted_at_any_instant_of_its_start_ends_and_leaves_no_process(number, tmp_path):
    (tmp_path / "suite.yaml").write_text(SUITE)
    words = [*GAUNTLET, "run", "suite.yaml", "--no-media", "--out"]
    bad = []
    for step in range(int(LAST_S / STEP_S)):
        after_s = 0.3 + step * STEP_S  # later than Python's own start, which has no handler yet
        process = psutil.Popen(
            [*words, f"run-{step}"], cwd=tmp_path, env=environment_of(), stdout=subprocess.PIPE, stderr=subprocess.PIPE
        )
        time.sleep(after_s)
        children = started_by(process)
        process.send_signal(number)
        began = time.monotonic()
        _, complaints = process.communicate(timeout=120)
        taken_s = time.monotonic() - began
        _, left = psutil.wait_procs(children, GONE_S)
        if process.returncode != 130 or b"Traceback" in complaints or taken_s > ENDS_S or left:
            bad.append((round(after_s, 1), process.returncode, round(taken_s, 1), complaints[-300:], left))
    assert bad == []
