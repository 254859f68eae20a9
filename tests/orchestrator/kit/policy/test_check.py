"""The check of a policy names its mistakes, and finds none where there are none."""

from pathlib import Path

import numpy as np
import pytest

from robogauntlet.orchestrator.episodes.policy_source import PolicySource, build_policy
from robogauntlet.orchestrator.kit.finding import Finding, Level
from robogauntlet.orchestrator.kit.policy import recording
from robogauntlet.orchestrator.kit.policy.check import Probe, check_policy, findings_of
from robogauntlet.policies import catalog
from robogauntlet.policies.contract import PolicyError
from tests.errors import one_line_error
from tests.remote_servers import answering, speaking

TOWARDS = """
import numpy as np

def chunk(value, gripper=-1.0):
    actions = np.zeros((4, 7))
    actions[:, :3] = value
    actions[:, 6] = gripper
    return actions
"""
COUNTING = """
    def __call__(self, images, proprioception, instruction):
        self.count += 1
        return chunk(0.001 * self.count)
"""


@pytest.fixture
def check(tmp_path, request, monkeypatch):
    """Writes a module and checks its policy `f`; returns the findings and whether there is a picture."""
    monkeypatch.syspath_prepend(tmp_path)
    name = f"checked_{abs(hash(request.node.name))}"

    def run(text, task="null/Reach", target="f", apart=False):
        (tmp_path / f"{name}.py").write_text(TOWARDS + text)
        options = {"callable": f"{name}:{target}", "folder": str(tmp_path)}
        return checked("python", options, task, apart=apart)

    return run


def checked(kind, options, task="null/Reach", image_size=None, apart=False):
    source = PolicySource(kind, options, catalog.digest(kind, options))
    probe = Probe(kind, source, task, image_size=image_size)
    results = list(check_policy(probe) if apart else findings_of(build_policy(source), probe))
    assert all("\n" not in result.text for result in results if isinstance(result, Finding))
    return results


def function(value, gripper=-1.0):
    return f"def f(images, proprioception, instruction):\n    return chunk({value}, {gripper})\n"


def found(results, topic):
    """The findings of a topic."""
    return [result for result in results if isinstance(result, Finding) and result.topic == topic]


def only(results, topic):
    (finding,) = found(results, topic)
    return finding


def failed(results):
    return [r.topic for r in results if isinstance(r, Finding) and r.level is Level.FAILED]


def test_a_task_of_two_arms_is_refused_in_one_line():
    with one_line_error(PolicyError, "one arm, to check a policy; .* has two arms"):
        checked("oracle", {}, "robosuite/TwoArmLift@TwoPandas")


def test_state_that_leaks_from_episode_to_episode_fails(check):
    results = check(f"class f:\n    count = 0\n{COUNTING}")
    assert failed(results) == ["state"]
    finding = only(results, "state")
    assert "from query 1 on" in finding.text
    assert "state leaks from episode to episode; write reset(self)" in finding.text
    assert finding.numbers["largest_difference"] > 0.001


def test_state_of_a_module_leaks_too(check):
    results = check(
        "QUERIES = []\n\ndef f(images, proprioception, instruction):\n    QUERIES.append(0)\n"
        "    return chunk(0.001 * len(QUERIES))\n"
    )
    assert failed(results) == ["state"]


def test_state_that_reset_sets_back_is_well(check):
    results = check(f"class f:\n    def reset(self):\n        self.count = 0\n{COUNTING}")
    assert failed(results) == []
    assert only(results, "state").level is Level.OK
    assert "bit-identical" in only(results, "state").text


def test_noise_of_an_unseeded_generator_is_a_warning_and_no_leak(check):
    results = check(
        "class f:\n    def __init__(self):\n        self.draw = np.random.default_rng().normal\n"
        "    def __call__(self, images, proprioception, instruction):\n        return chunk(0.01 * self.draw())\n"
    )
    assert failed(results) == []
    assert only(results, "determinism").level is Level.WARNING
    assert "hides what the policy looks at" in only(results, "input").text
    assert "in a new process: other actions" in only(results, "determinism").text


@pytest.mark.parametrize(
    ("value", "level", "text"),
    [
        ("0.9", Level.WARNING, "look normalised to [-1, 1], expected metres"),
        ("20.0", Level.WARNING, "are not metres per step: millimetres"),
        ("proprioception[:3] + 0.02", Level.WARNING, "expected displacements per step, not target positions"),
        ("0.07", Level.WARNING, "100 % of the actions are beyond the limit of 0.05 m per step, and are clipped"),
        ("1e-5", Level.WARNING, "the tool hardly moves"),
        ("0.02 * images['wrist'].mean() / 255", Level.OK, "within the limit of 0.05 m"),
    ],
)
def test_units_are_judged_by_the_limits(check, value, level, text):
    finding = only(check(function(value)), "translation")
    assert (finding.level, text in finding.text) == (level, True), finding.text


@pytest.mark.parametrize(
    ("value", "text"), [("0.0", "the policy stands still"), ("0.01", "actions are the same: 0.01, 0.01, 0.01, 0")]
)
def test_constant_actions_are_told(check, value, text):
    assert text in only(check(function(value)), "motion").text


@pytest.mark.parametrize(
    ("gripper", "level", "text"),
    [
        ("-1.0", Level.NOTE, "always -1: it never closes"),
        ("1.0", Level.NOTE, "always 1: it never opens"),
        ("float(proprioception[0] > 0) ", Level.WARNING, "two values, 0 and 1: expected -1 (open) to 1 (closed); if"),
        ("1.0 if proprioception[0] > 0 else -1.0", Level.OK, "two values, -1 and 1: it opens and closes ("),
        ("2.0 * proprioception[0]", Level.OK, "continuous, from "),
        ("50.0 * proprioception[0]", Level.WARNING, "expected -1 (open) to 1 (closed)"),
    ],
)
def test_the_gripper_is_described(check, gripper, level, text):
    finding = only(check(function("np.array([-0.05, 0, 0]) * np.sign(proprioception[0])", gripper)), "gripper")
    assert (finding.level, text in finding.text) == (level, True), finding.text


@pytest.mark.parametrize(
    ("returned", "text"),
    [
        ("chunk(np.nan)", "expected finite actions, got nan in the chunk"),
        ("np.zeros((4, 8))", "expected an action chunk of shape (n, 7) with n >= 1, got (4, 8)"),
        ("'left'", "expected an action chunk of numbers"),
        ("[][0]", "raised IndexError: list index out of range [checked_"),
    ],
)
def test_an_answer_that_is_no_chunk_fails(check, returned, text):
    results = check(f"def f(images, proprioception, instruction):\n    return {returned}\n")
    assert failed(results) == ["answer"]
    assert text in only(results, "answer").text


@pytest.mark.parametrize("kind", ["SystemExit", "KeyboardInterrupt"])
def test_a_policy_that_would_end_the_command_is_a_finding(check, kind):
    results = check(f"def f(images, proprioception, instruction):\n    raise {kind}('enough')\n")
    assert f"the policy raised {kind}: enough [checked_" in only(results, "answer").text


@pytest.mark.parametrize(
    ("does", "text"),
    [
        ("os.chdir('/'); threading.Thread(target=threading.Event().wait).start()", None),
        ("os._exit(3)", "the policy ended its process"),
    ],
)
def test_whatever_a_policy_does_to_its_process_the_command_goes_on(check, does, text):
    place = Path.cwd()
    results = check(
        f"import os, threading\ndef f(images, proprioception, instruction):\n    {does}\n    return chunk(0.01)\n",
        apart=True,
    )
    assert Path.cwd() == place
    assert [finding.text for finding in found(results, "answer")] == ([text] if text else [])


def test_a_policy_that_hangs_is_a_finding(check, monkeypatch):
    monkeypatch.setattr(recording, "LIMIT_S", 0.2)
    results = check("import time\n\ndef f(images, proprioception, instruction):\n    time.sleep(5)\n")
    assert only(results, "answer").text == "expected an answer within 0.2 s, got none; find out where the policy hangs"


def test_a_policy_that_does_not_look_is_told_so(check):
    findings = found(check(function("-0.02 * proprioception[:3]")), "input")
    texts = {finding.text for finding in findings}
    assert "all images black: the same actions; the policy does not look at the images" in texts
    assert "other instruction: the same actions; the policy does not use it" in texts
    assert any(text.startswith("other proprioception: the actions change by") for text in texts)


def test_a_policy_that_looks_with_one_camera_is_told_which(check):
    findings = found(check(function("0.01 * images['wrist'].mean() / 255")), "input")
    texts = [finding.text for finding in findings]
    assert any(text.startswith("wrist black: the actions change by 100 %") for text in texts)
    assert "third_person black: the same actions; the policy does not use this camera" in texts


def test_a_policy_that_refuses_a_changed_observation_is_told_so_and_checked_further(check):
    results = check(
        "def f(images, proprioception, instruction):\n    assert images['wrist'].any(), 'it is dark'\n"
        "    return chunk(0.01 * images['wrist'].mean() / 255)\n"
    )
    finding = next(finding for finding in found(results, "input") if finding.text.startswith("all images black"))
    assert finding.level is Level.WARNING
    assert "AssertionError: it is dark" in finding.text
    assert only(results, "state").level is Level.OK


def test_a_policy_without_images_has_no_findings_about_them():
    results = checked("oracle", {}, "pybullet/PandaReach-v3")
    assert only(results, "input").text == "the policy gets the true state instead of images"
    assert found(results, "images") == []
    assert only(results, "approach").level is Level.OK


@pytest.mark.simulator
def test_each_number_is_told_by_what_it_moves_in_the_simulation(check):
    results = check(function("np.array([0.02, -0.01, 0.005])", "1.0"), "pybullet/PandaPickAndPlace-v3")
    assert "moves the tool forward (+x)" in only(results, "dx").text
    assert "moves the tool right (-y)" in only(results, "dy").text
    assert "moves the tool up (+z)" in only(results, "dz").text
    assert only(results, "rx").text == "always 0; this task ignores it"
    assert only(results, "dx").numbers["x_m_per_step"] == pytest.approx(0.02, rel=0.5)
    fingers = only(results, "fingers").numbers
    assert fingers["open_m"] > 0.07
    assert fingers["closed_m"] < 0.02
    assert "forward" in only(results, "path").text
    picture = results[-1]
    assert picture.dtype == np.uint8
    assert picture.shape[2] == 3
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 200, "the rendered images are in it"


@pytest.mark.simulator
def test_a_turned_image_changes_the_answers_of_a_policy_that_looks(check):
    results = check(function("0.0002 * images['third_person'][:48].mean()"), "pybullet/PandaReach-v3")
    upside_down = next(f for f in found(results, "input") if f.text.startswith("images upside down"))
    assert "the actions change by" in upside_down.text


def test_frames_have_the_size_that_the_policy_asks_for_and_smaller_ones_are_warned_of():
    with speaking(answering({"actions": np.zeros((16, 7))}, metadata={})) as address:
        options = {"address": address, "image_size": 48, "execute": 16}
        asked, smaller = checked("openpi", options), checked("openpi", options, image_size=32)
    assert [finding.level for finding in found(asked, "images")] == [Level.NOTE]
    assert [finding.text for finding in found(smaller, "images") if finding.level is Level.WARNING] == [
        "frames are rendered at 32 px and enlarged to 48; leave --image-size out"
    ]
    assert "all executed" in " ".join(finding.text for finding in asked if isinstance(finding, Finding))
