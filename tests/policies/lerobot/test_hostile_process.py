"""LeRobot's process, which computes what a checkpoint says, cannot harm its parent by its answers."""

import json
import sys

import numpy as np
import pytest

from robogauntlet.adapters.contract import Observation
from robogauntlet.policies import catalog
from robogauntlet.policies.contract import PolicyError, Query
from robogauntlet.policies.lerobot.lerobot_policy import ProcessLost
from robogauntlet.suites.episode import Episode, Protocol, View
from tests.errors import one_line_error

QUERY = Query(
    Episode("p", "d", "null/Reach", 0, Protocol(6, 8, View(("third_person",), 32))),
    0,
    Observation({"third_person": np.zeros((32, 32, 3), np.uint8)}, np.zeros(8), "reach"),
)


@pytest.fixture
def answering(bare, tmp_path):
    """Loads a checkpoint in a program that gives these answers in the place of LeRobot's process."""
    folder = bare()

    def load(*answers):
        program = tmp_path / "program"
        code = "import os, sys, time\nfd = int(sys.argv[-1])\n" + "\n".join(answers) + "\ntime.sleep(60)\n"
        program.write_text(f"#!{sys.executable}\n{code}")
        program.chmod(0o755)
        options = {"checkpoint": str(folder), "python": str(program), "timeout_s": 2.0}
        return catalog.load("lerobot", options)

    return load


def line(answer):
    return f"os.write(fd, {json.dumps(answer).encode() + bytes([10])!r})"


READY = line({"actions": 3})
ACTIONS = {
    "800 GB": ["<f8", [10**11], "AAAA"],
    "objects": ["|O", [1], "AAAAAAAAAAA="],
    "no array": 3,
    "no shape": ["<f4", None, "AAAAAA=="],
    "no base64": ["<f4", [1], 5],
    "text": ["<U1", [1, 7], "A" * 38],
}


@pytest.mark.parametrize("action", ACTIONS.values(), ids=ACTIONS)
def test_an_answer_that_is_no_array_is_one_line(answering, action):
    policy = answering(READY, "sys.stdin.readline()", line({"action": action}))
    with one_line_error(PolicyError, "^policy 'lerobot': expected "):
        policy.act([QUERY])
    policy.close()


@pytest.mark.parametrize(
    ("answer", "match"),
    [
        (
            "os.write(fd, b'warning: old driver\\n')",
            "expected an answer in JSON, the process sent 'warning: old driver'",
        ),
        ("os.write(fd, b'{')", "did not answer within 2 s"),
        (line([1]), "expected a mapping from its process, got list"),
        ("os.write(fd, b'[' * 60000 + b'\\n')", "expected an answer in JSON"),
    ],
)
def test_an_answer_that_cannot_be_read_is_one_line(answering, answer, match):
    policy = answering(READY, "sys.stdin.readline()", answer)
    with one_line_error(ProcessLost, f"^policy 'lerobot': .*{match}"):
        policy.act([QUERY])
    policy.close()
