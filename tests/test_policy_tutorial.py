"""The steps of docs/python-policies.md lead from an empty folder to a table, with a policy that passes its check."""

import re
import shlex
import sys

import pytest
from PIL import Image

from tests.processes import run_gauntlet, run_process
from tests.tutorials import blocks

pytestmark = [pytest.mark.simulator, pytest.mark.ray]


def test_every_command_of_the_page_works(tmp_path):
    folder, printed = tmp_path, []
    for path, text in blocks("python-policies"):
        if path is not None:
            (folder / path).write_text(text, encoding="utf-8")
            continue
        for line in text.splitlines():
            program, *arguments = shlex.split(line)
            if program == "cd":
                folder /= arguments[0]
                continue
            run = {
                "robogauntlet": lambda words, place: run_gauntlet(*words, cwd=place),
                "python": lambda words, place: run_process([sys.executable, *words], place),
            }[program]
            done = run(arguments, folder)
            assert done.returncode == 0, f"{line}\n{done.stdout}\n{done.stderr}"
            printed.append(done.stdout)
    assert "3 passed" in printed[1]
    assert " 0 failed, " in printed[2]
    assert Image.open(folder / "runs" / "policy-check.png").width > 500
    assert "10 of 10 episodes" in printed[3]
    assert re.search(r"dx .* moves the tool forward \(\+x\)", printed[4])
    assert "ok       state        the same episode after another one: the same actions" in printed[5]
