"""The house stays as it was designed: arrows one way, light where it must be light, no file too long."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROOMS = {
    "suites": set(),
    "adapters": {"suites"},
    "results": {"suites"},
    "policies": {"suites", "adapters"},
    "orchestrator": {"suites", "adapters", "results", "policies"},
}
LONGEST = 400


def imports(path):
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_imports_only_the_rooms_below_it(room):
    files = list((ROOT / room).rglob("*.py"))
    assert files
    used = {(path.name, name) for path in files for name in imports(path) if name.partition(".")[0] in ROOMS}
    against = {(path, name) for path, name in used if name.partition(".")[0] not in ROOMS[room] | {room}}
    assert not against


def test_policies_know_no_single_simulator():
    allowed = {"adapters.contract", "adapters.catalog", "adapters.frames"}
    names = {name for path in (ROOT / "policies").rglob("*.py") for name in imports(path)}
    assert {name for name in names if name.startswith("adapters")} <= allowed


@pytest.mark.parametrize(
    "module",
    ["results.statistics.pairs", "adapters.contract", "policies.contract", "adapters.catalog", "policies.catalog"],
)
def test_what_must_be_light_loads_no_simulator_no_torch_and_no_ray(module):
    heavy = ("torch", "ray", "mani_skill", "sapien", "pybullet", "panda_gym", "robosuite", "mujoco")
    code = f"import sys, {module}\nprint([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.strip() == "[]"


def test_declaring_every_plugin_loads_no_simulator_and_no_torch():
    code = (
        "import sys\nfrom orchestrator.names import known_names\nassert len(known_names().tasks) > 9\n"
        "print([m for m in ('torch', 'ray', 'mani_skill', 'sapien', 'panda_gym', 'mujoco') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.strip() == "[]"


def test_no_file_grows_past_the_limit():
    files = [path for folder in (*ROOMS, "tests") for path in (ROOT / folder).rglob("*.py")]
    assert {str(p): n for p in files if (n := len(p.read_text(encoding="utf-8").splitlines())) > LONGEST} == {}
