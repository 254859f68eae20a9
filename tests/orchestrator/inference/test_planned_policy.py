"""Whatever a policy's code does while a run is planned, the command goes on, or says in one line why not."""

import sys
import threading
from contextlib import closing
from pathlib import Path

import pytest

from robogauntlet.adapters.contract import TaskDescription
from robogauntlet.orchestrator.episodes.policy_source import PolicySource
from robogauntlet.orchestrator.inference import planned_policy
from robogauntlet.orchestrator.inference.planned_policy import PlannedPolicy, planned_spec
from robogauntlet.policies.contract import PolicyError, PolicyInput, PolicySpec
from robogauntlet.suites.episode import View
from robogauntlet.support.secret_variables import POLICY_TOKEN
from tests.errors import one_line_error

WANDERING = """
import os, threading, numpy as np

os.chdir("/")
threading.Thread(target=threading.Event().wait).start()

def act(images, proprioception, instruction):
    assert images["wrist"].shape == (16, 16, 3) and instruction == "reach"
    return np.zeros((8, 7))
"""
ANSWERS = {
    "complex numbers": ("np.zeros((8, 7), complex)", "expected an action chunk of numbers.*complex128"),
    "objects": ("np.array([[10 ** 400] * 7], dtype=object)", "expected an action chunk of numbers.*int too large"),
    "KeyboardInterrupt": ("raised(KeyboardInterrupt())", r"it ended its process \(KeyboardInterrupt\)"),
    "the end": ("os._exit(3)", "expected its first answer, the process ended with code 3"),
}
MODULES = {
    "KeyboardInterrupt": ("raise KeyboardInterrupt", "raised KeyboardInterrupt"),
    "sys.exit": ("import sys; sys.exit('enough')", "raised SystemExit: enough"),
    "the end": ("import os; os._exit(3)", "expected to be imported and built, the process ended with code 3"),
    "no spec": (
        "from robogauntlet.policies.contract import *\n"
        "class act(StatelessPolicy):\n  spec = PolicySpec(PolicyInput.NOTHING, 'eight')\n  def act(self, queries): ...",
        "expected a spec of the contract: chunk_length",
    ),
    "a spec of an object": (
        "from robogauntlet.policies.contract import *\n"
        "class act(StatelessPolicy):\n  spec = PolicySpec(PolicyInput.NOTHING, object())\n  def act(self, asked): ...",
        "expected a spec of the contract: chunk_length",
    ),
}
NUMPY = """
import numpy as np
from robogauntlet.policies.contract import *

class act(StatelessPolicy):
    spec = PolicySpec(PolicyInput.OBSERVATION, np.int64(8), image_size=np.int32(96), variants=np.bool_(True))
    def act(self, queries): ...
"""


@pytest.fixture
def source(tmp_path):
    def write(text):
        (tmp_path / "planned_by_a_test.py").write_text(text)
        return PolicySource("python", {"callable": "planned_by_a_test:act", "folder": str(tmp_path)})

    return write


def ask(policy):
    policy.check_answer(View(("wrist",), 16), TaskDescription("reach", 60))


def test_a_module_that_wanders_and_never_ends_leaves_the_command_where_it_is(source):
    place, threads = Path.cwd(), threading.active_count()
    with closing(PlannedPolicy("mine", source(WANDERING))) as policy:
        assert policy.spec.sees is PolicyInput.OBSERVATION
        ask(policy)
    assert (Path.cwd(), threading.active_count()) == (place, threads)
    assert "planned_by_a_test" not in sys.modules


@pytest.mark.parametrize(("answer", "match"), ANSWERS.values(), ids=ANSWERS)
def test_an_odd_first_answer_is_one_line(source, answer, match):
    text = f"""
import os, numpy as np

def raised(error):
    raise error

def act(images, proprioception, instruction):
    return {answer}
"""
    with closing(PlannedPolicy("mine", source(text))) as policy, one_line_error(PolicyError, f"policy 'mine'.*{match}"):
        ask(policy)


@pytest.mark.parametrize(("text", "match"), MODULES.values(), ids=MODULES)
def test_an_odd_module_is_one_line(source, text, match):
    with one_line_error(PolicyError, match):
        planned_spec("mine", source(text))


def test_a_module_that_hangs_is_one_line(source, monkeypatch):
    monkeypatch.setattr(planned_policy, "LOADING_S", 2.0)
    with one_line_error(PolicyError, "expected to be imported and built within 2 s, got none; find out where it hangs"):
        planned_spec("mine", source("while True: pass"))


def test_a_module_gets_the_tokens_of_policy_servers_as_in_workers_and_no_other_secret(source, monkeypatch):
    monkeypatch.setenv("GITHUB_TOKEN", "secret")
    monkeypatch.setenv(POLICY_TOKEN, "token")
    with one_line_error(PolicyError, "KeyError: 'GITHUB_TOKEN'"):
        planned_spec("mine", source(f"import os; os.environ['{POLICY_TOKEN}']; os.environ['GITHUB_TOKEN']"))


def test_numbers_of_numpy_in_a_spec_are_numbers(source):
    spec = planned_spec("mine", source(NUMPY))
    assert spec == PolicySpec(PolicyInput.OBSERVATION, 8, image_size=96, variants=True)
