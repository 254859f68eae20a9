"""The page about running from Python is followed word by word, with fewer seeds."""

import re
import sys

import pytest

from tests import ROOT
from tests.processes import run_process

PAGE = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")


@pytest.mark.simulator
@pytest.mark.ray
@pytest.mark.nightly
def test_the_code_of_the_page_runs_from_top_to_bottom(tmp_path):
    blocks = re.findall(r"^```python\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
    code = "\n".join(blocks)
    assert "seeds=10" in code
    (tmp_path / "page.py").write_text(code.replace("seeds=10", "seeds=3"))
    done = run_process([sys.executable, "page.py"], tmp_path)
    assert done.returncode == 0, done.stderr
    assert "suite pybullet-PandaReach-v3, 6 episodes planned, complete" in done.stdout
    assert re.search(r"act\s+pybullet/PandaReach-v3\s+clean\s+\d\.\d\d", done.stdout)
    assert re.fullmatch(r"(success|failure) \d+ [0-9a-f]+", done.stdout.splitlines()[-1])
