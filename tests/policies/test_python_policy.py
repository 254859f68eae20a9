"""Any Python callable as a policy: found by name, hashed by source, with errors of one line."""

import re
import sys

import pytest

from robogauntlet.orchestrator.episodes.episode_runner import EpisodeRunner
from robogauntlet.orchestrator.episodes.lease import Lease
from robogauntlet.orchestrator.episodes.policy_source import PolicySource, bundle_layout
from robogauntlet.policies import catalog
from robogauntlet.policies.contract import PolicyError, PolicyInput
from robogauntlet.suites.episode import Cell, Protocol, View
from tests.errors import one_line_error

FUNCTION = """
import numpy as np

def towards(images, proprioception, instruction, speed=0.01):
    assert instruction == "reach the goal" and proprioception.shape == (8,)
    return np.full((4, 7), speed * images["wrist"].mean() / 255)

class Caller:
    def __init__(self, speed=0.01):
        self.speed = speed

    def __call__(self, images, proprioception, instruction):
        return towards(images, proprioception, instruction, self.speed)
"""
POLICY = """
from .scale import SCALE
import numpy as np
from robogauntlet.policies.contract import Decision, PolicySpec, PolicyInput, StatelessPolicy

class Still(StatelessPolicy):
    spec = PolicySpec(PolicyInput.NOTHING, 2)

    def __init__(self, value=0.0):
        self.value = value

    def act(self, queries):
        return [Decision(np.full((2, 7), SCALE * self.value)) for _ in queries]

def make(value=0.5):
    return Still(value)
"""


@pytest.fixture(autouse=True)
def imports(monkeypatch):
    """Undoes what a test imports."""
    before = set(sys.modules)
    monkeypatch.setattr(sys, "path", list(sys.path))
    yield
    for added in set(sys.modules) - before:
        del sys.modules[added]


@pytest.fixture
def module(tmp_path, request):
    """Writes a module of a name of its own; returns `options(callable, ...)`."""
    name = f"module_{abs(hash(request.node.name))}"

    def write(text):
        (tmp_path / f"{name}.py").write_text(text)
        return lambda what, **more: {"callable": f"{name}:{what}", "folder": str(tmp_path), **more}

    return write


@pytest.fixture
def package(tmp_path):
    folder = tmp_path / "robot_brains"
    folder.mkdir()
    (folder / "__init__.py").touch()
    (folder / "still.py").write_text(POLICY)
    (folder / "scale.py").write_text("SCALE = 0.1\n")
    return folder


def play(options, seeds=range(3)):
    digest = catalog.digest("python", options)
    runner = EpisodeRunner({"mine": PolicySource("python", options, digest)})
    cell = Cell("mine", digest, "null/Reach", Protocol(12, 4, View(image_size=16)))
    return list(runner.play(Lease(cell, tuple(seeds))))


def refused(options, match):
    with one_line_error(PolicyError, match):
        catalog.spec("python", options)


@pytest.mark.parametrize(("name", "args"), [("towards", {}), ("towards", {"speed": 0.02}), ("Caller", {"speed": 1.0})])
def test_a_plain_function_or_one_that_a_class_makes_acts(module, name, args):
    options = module(FUNCTION)(name, options=args)
    assert catalog.spec("python", options).sees is PolicyInput.OBSERVATION
    assert [row.status for row in play(options)] == ["failure"] * 3


def test_rows_of_a_class_with_reset_do_not_depend_on_their_order(module):
    text = """
class Counter:
    queries = 0

    def reset(self):
        self.queries = 0

    def __call__(self, images, proprioception, instruction):
        self.queries += 1
        return [[1e-3 * self.queries] * 7]
"""
    first, _, again = play(module(text)("Counter"), (0, 1, 0))
    assert first.actions_hash == again.actions_hash


@pytest.mark.parametrize("name", ["Still", "make"])
def test_a_class_or_a_factory_of_a_package_acts(package, name):
    options = {"callable": f"robot_brains.still:{name}", "folder": str(package.parent), "options": {"value": 0.5}}
    assert catalog.spec("python", options).sees is PolicyInput.NOTHING
    rows = play(options)
    assert [row.error for row in rows] == [None] * 3
    assert rows[0].queries == 6


def test_the_digest_covers_source_options_and_files(package):
    options = {"callable": "robot_brains.still:Still", "folder": str(package.parent), "files": ["weights.bin"]}
    weights = package.parent / "weights.bin"
    weights.write_bytes(b"1")
    seen = [catalog.digest("python", options)]
    assert catalog.digest("python", options) == seen[0]
    (package / "still.py").write_bytes(POLICY.replace("\n", "\r\n").encode())
    assert catalog.digest("python", options) == seen[0]
    seen.append(catalog.digest("python", {**options, "options": {"value": 1.0}}))
    seen.append(catalog.digest("python", {**options, "files": []}))
    (package / "scale.py").write_text("SCALE = 0.2\n")
    seen.append(catalog.digest("python", options))
    weights.write_bytes(b"2")
    seen.append(catalog.digest("python", options))
    assert len(set(seen)) == 5
    assert "robot_brains" not in sys.modules, "hashing must not import the policy"


def test_a_copy_on_another_node_is_the_same_policy(package, tmp_path):
    options = {"callable": "robot_brains.still:Still", "folder": str(package.parent)}
    chosen, files = bundle_layout(catalog.find("python").files(options))
    assert set(chosen) == {"folder"}
    copy = tmp_path / "node"
    for place, path in files.items():
        (copy / place).parent.mkdir(parents=True, exist_ok=True)
        (copy / place).write_bytes(path.read_bytes())
    there = {**options, "folder": str(copy / chosen["folder"])}
    assert catalog.digest("python", there) == catalog.digest("python", options)


def test_a_missing_module_or_name_is_one_line(module, package):
    options = module(FUNCTION)
    refused({}, "expected python:MODULE:NAME, or option callable: MODULE:NAME, got None")
    refused({"callable": "os.system"}, "expected python:MODULE:NAME, or option callable: MODULE:NAME, got 'os.system'")
    refused({"callable": "../../x:y"}, "expected python:MODULE:NAME")
    refused(options("towards", folder="nowhere"), "expected option folder: a folder, got 'nowhere'")
    refused(options("towards", files=["../secret"]), "expected a file below")
    refused(options("towards", options=[1]), "expected option options: a mapping")
    absent = {**options("x"), "callable": "no_such_module_here:x"}
    refused(absent, "expected a module 'no_such_module_here' in .* give its folder")
    refused({**options("x"), "callable": "robot_brains.nothing:x"}, "expected a module 'robot_brains.nothing'")
    refused(options("toward"), "has no 'toward'; did you mean 'towards'")
    refused(options("np.pi"), "expected a class or a function, got float")
    refused(options("towards", options={"sped": 1}), "options do not fit the function: got an unexpected keyword")
    refused(options("Caller", options={"sped": 1}), "building it raised TypeError")


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("import nothing_like_it\n", "importing '.*' raised ModuleNotFoundError: No module named 'nothing_like_it'"),
        ("def f(:\n", "importing '.*' raised SyntaxError"),
        ("raise RuntimeError('no GPU\\nhere')\n", "raised RuntimeError: no GPU$"),
        ("import sys; sys.exit(3)\n", "raised SystemExit: 3"),
        (
            "class f:\n    reset = act = finish = print\n",
            "expected attribute spec, a robogauntlet.policies.contract.PolicySpec",
        ),
    ],
)
def test_a_module_that_cannot_be_used_is_one_line(module, text, match):
    refused(module(text)("f"), match)


def test_a_module_that_fails_hides_none_of_its_name_in_another_folder(tmp_path):
    for folder, text in (("first", "raise RuntimeError('no GPU')\n"), ("second", FUNCTION)):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "namesakes.py").write_text(text)
    refused({"callable": "namesakes:towards", "folder": str(tmp_path / "first")}, "raised RuntimeError: no GPU")
    catalog.load("python", {"callable": "namesakes:towards", "folder": str(tmp_path / "second")})


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("def f():\n    return 3\n", r"expected a function of images, proprioception, instruction, .* got int without"),
        (
            "class f:\n    pass\n",
            r"a class with __call__\(self, images, proprioception, instruction\), .* got f without",
        ),
        (
            "def f(obs):\n    pass\n",
            r"expected parameters named images, .* found f\(obs\), which needs obs; write def f\(",
        ),
        ("def f(imgs, state, text):\n    pass\n", r"found f\(imgs, state, text\), which needs imgs, state, text"),
        ("class f:\n    def __call__(self, obs):\n        pass\n", r"found __call__\(self, obs\); use these names"),
        ("class f:\n    def act(self, obs):\n        pass\n", r"found no reset; or write __call__\(self, images"),
        (
            "class f:\n    def __call__(self, images, proprioception, instruction):\n        pass\n"
            "    def reset(self, seed):\n        pass\n",
            r"expected reset\(self\) without further parameters, .* found reset\(self, seed\)",
        ),
    ],
)
def test_a_callable_of_another_signature_is_answered_with_what_to_write(module, text, match):
    refused(module(text)("f"), match)


@pytest.mark.parametrize(
    ("returned", "match"),
    [
        ("np.zeros(7)", r"f: expected an action chunk of shape \(n, 7\) with n >= 1, got \(7,\)"),
        ("np.zeros((2, 8))", r"got \(2, 8\)"),
        ("np.full((2, 7), np.nan)", "f: expected finite actions, got nan in the chunk"),
        ("'left'", "f: expected an action chunk of numbers"),
        ("None", "f: expected an action chunk"),
        ("[][0]", r"IndexError: list index out of range \[module_\d+.py:4\]"),
    ],
)
def test_an_answer_that_is_no_chunk_is_an_error_and_the_run_goes_on(module, returned, match):
    options = module(f"import numpy as np\n\ndef f(images, proprioception, instruction):\n    return {returned}\n")
    rows = play(options("f"))
    assert [row.status for row in rows] == ["error"] * 3
    for row in rows:
        assert re.search(match, row.error)
        assert "\n" not in row.error


def test_another_module_of_the_same_name_is_refused(package, tmp_path):
    options = {"callable": "robot_brains.still:Still", "folder": str(package.parent)}
    catalog.load("python", options)
    other = tmp_path / "other" / "robot_brains"
    other.mkdir(parents=True)
    for file in package.glob("*.py"):
        (other / file.name).write_text(file.read_text())
    refused({**options, "folder": str(other.parent)}, "got another of that name from .*; rename 'robot_brains'")


def test_an_object_is_free_again_after_an_episode_that_ended_with_an_error(module):
    text = """
class Broken:
    def reset(self):
        pass

    def __call__(self, images, proprioception, instruction):
        return [[float("nan")] * 7]

broken = Broken()
"""
    rows = play(module(text)("broken"))
    assert all("expected finite actions" in row.error for row in rows), [row.error for row in rows]
