"""What is derived from kept runs is what it was."""

import subprocess
import sys

import pytest

from tests import ROOT
from tests.golden.kept import KINDS


@pytest.mark.parametrize("kind", KINDS)
def test_a_kept_run_gives_what_it_gave(kind):
    command = (sys.executable, "-m", "tests.golden", kind)
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
