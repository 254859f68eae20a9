"""`robogauntlet new policy` and `robogauntlet check policy`."""

import json
import sys

import numpy as np
import pytest
from PIL import Image

from tests.full_disk import full_disk
from tests.processes import run_gauntlet, run_process

FUNCTION = "import numpy as np\n\ndef act(images, proprioception, instruction):\n    return np.full((4, 7), {})\n"
NULL = ("--task", "null/Reach")


@pytest.fixture
def imports(monkeypatch, tmp_path):
    """Forgets the modules that a command imports from its folder."""
    before = set(sys.modules)
    monkeypatch.setattr(sys, "path", list(sys.path))
    yield
    for name in set(sys.modules) - before:
        if str(tmp_path) in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]


def test_a_new_policy_passes_its_own_tests(tmp_path):  # its check and its suite: tests/test_policy_tutorial.py
    created = run_gauntlet("new", "policy", "my_policy", cwd=tmp_path)
    assert "robogauntlet check policy python:my_policy:MyPolicy" in created.stdout, created.stderr
    tested = run_process([sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"], tmp_path / "my_policy")
    assert tested.returncode == 0, tested.stdout
    assert "3 passed" in tested.stdout


@pytest.mark.parametrize("name", ["MyPolicy", "my-policy", "my policy", "_x", "1x", "a" * 41, "../up"])
def test_a_name_that_is_no_module_is_refused_and_nothing_is_written(run_command, tmp_path, name):
    assert f"such as my_policy; got '{name}'" in run_command("new", "policy", "--", name).refusal
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["random", "numpy", "import"])
def test_the_name_of_another_module_is_refused(run_command, tmp_path, name):
    assert f"a Python module '{name}' exists already" in run_command("new", "policy", name).refusal
    assert not list(tmp_path.iterdir())


def test_a_folder_that_exists_or_cannot_be_written_is_one_line(run_command, tmp_path):
    (tmp_path / "mine").mkdir()
    assert run_command("new", "policy", "mine").refusal == "mine exists; give another folder with --out"
    with full_disk():
        assert "cannot be written: File too large" in run_command("new", "policy", "other").refusal
    assert not (tmp_path / "other").exists()


@pytest.mark.usefixtures("imports")
def test_a_sure_mistake_exits_with_1_and_json_has_every_finding(run_command, tmp_path):
    (tmp_path / "checked_broken.py").write_text(FUNCTION.format("np.nan"))
    done = run_command("check", "policy", "python:checked_broken:act", *NULL)
    assert done.code == 1
    assert "FAILED   answer       act: expected finite actions, got nan" in done.out
    assert not (tmp_path / "runs").exists(), "no picture without an episode"
    moving = FUNCTION.format("0.01 * images['wrist'].mean() / 255").replace(
        "    return", "    print('seen')\n    return"
    )
    (tmp_path / "checked_moving.py").write_text(moving)
    done = run_command("check", "policy", "python:checked_moving:act", *NULL, "--json", "--picture", "out/seen.png")
    document = json.loads(done.out)
    assert done.code == 0
    assert {"translation", "dx", "gripper", "input", "state", "latency"} <= {f["topic"] for f in document["findings"]}
    assert document["picture"] == "out/seen.png"
    assert np.asarray(Image.open(tmp_path / "out" / "seen.png")).std() > 0


@pytest.mark.usefixtures("imports")
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["python:checked_brains:nothing"], "checked_brains has no 'nothing'"),
        (["python:no_such_module:act"], "expected a module 'no_such_module'"),
        (["python:checked_brains:Silent"], "got Silent without __call__"),
        (["python:checked_brains:other"], "write def other(images, proprioception, instruction)"),
        (["openpi://127.0.0.1:1", "--option", "retries=0"], "no connection"),
        (["untraned"], "did you mean 'untrained'?"),
        (["untrained", "--task", "null/Rech"], "unknown task 'null/Rech'; did you mean 'null/Reach'?"),
        (["untrained", "--picture", "a.jpg"], "expected a file that ends in .png for --picture, got 'a.jpg'"),
        (["replay", "--task", "null/Reach"], "policy 'replay' does not fit: it cannot act in null/Reach; it can in "),
    ],
)
def test_a_policy_that_cannot_be_checked_is_one_line(run_command, tmp_path, arguments, message):
    (tmp_path / "checked_brains.py").write_text("class Silent:\n    pass\n\ndef other(observation):\n    pass\n")
    task = [] if "--task" in arguments else NULL
    assert message in run_command("check", "policy", *arguments, *task).refusal
    assert [path.name for path in tmp_path.iterdir() if path.name != "__pycache__"] == ["checked_brains.py"]
