"""What Ray started is ended when its start is interrupted, also where nobody reaps the processes of others."""

import subprocess
import sys

STARTS = """
import subprocess, sys, time
from robogauntlet.orchestrator.ray_runtime import session
below = "import subprocess; one = subprocess.Popen(['sleep', '60']); print(one.pid, flush=True); one.wait()"
child = subprocess.Popen([sys.executable, "-c", below], stdout=subprocess.PIPE)
orphan = session.psutil.Process(int(child.stdout.readline()))
session._end_children(but=())
ended = child.poll() is not None
until = time.monotonic() + 30  # a kill of a process that is not waited for is done when the system comes to it
while (left := orphan.is_running() and orphan.status() != "zombie") and time.monotonic() < until:
    time.sleep(0.02)
print(ended, not left)
"""
REAPS_NONE = f"""
import ctypes, subprocess, sys
ctypes.CDLL(None).prctl(36, 1)  # PR_SET_CHILD_SUBREAPER: orphans below become its children, which it leaves as zombies
sys.exit(subprocess.run([sys.executable, "-c", {STARTS!r}], timeout=60).returncode)
"""


def test_an_orphan_that_nobody_reaps_does_not_hold_up_the_end():
    done = subprocess.run([sys.executable, "-c", REAPS_NONE], capture_output=True, text=True, timeout=90, check=False)
    assert done.stdout == "True True\n", done.stderr
