"""The wheels with the newest packages, with the lowest and beside those of a lab, and the action of a code host."""

import json
import os
import re
import runpy
import shlex
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pip
import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

from tests import ROOT
from tests.hosted_actions import HostedRunner, write_program
from tests.orchestrator.conftest import ray_here, room_for_one

__all__ = ["ray_here", "room_for_one"]

HELP = """
import sys
from typer.main import get_command
from robogauntlet.orchestrator.cli import app
from typer.testing import CliRunner

def walk(command, words):
    done = CliRunner().invoke(app, [*words, "--help"])
    assert done.exit_code == 0, (words, done.output, done.exception)
    assert "Usage: " in done.output, words
    count = 1
    for name in command.list_commands(None) if hasattr(command, "list_commands") else ():
        count += walk(command.get_command(None, name), [*words, name])
    return count

print(walk(get_command(app), []))
"""
VERSIONS = "import json, numpy, pandas; print(json.dumps([numpy.__version__, pandas.__version__]))"
VALIDATE = """
import sys
from robogauntlet.orchestrator.cli import app
from typer.testing import CliRunner

for suite in sys.argv[1:]:
    done = CliRunner().invoke(app, ["plan", "--check", suite])
    assert done.exit_code == 0, (suite, done.output, done.exception)
"""


LIGHT = (
    "suites",
    "results/test_api.py",
    "results/analysis/test_robustness.py",
    "results/analysis/test_tables.py",
    "results/analysis/test_paired_behaviour.py",
    "results/analysis/test_condition_comparison.py::test_the_loss_at_every_level_is_paired_and_tested",
    "adapters/test_contract.py",
    "adapters/test_catalog.py",
    "adapters/test_camera_geometry.py",
    "adapters/test_photometry.py",
    "policies/test_function_policy.py",
    "policies/remote/test_msgpack_numpy.py",
    "policies/remote/test_conventions.py",
    "orchestrator/episodes/test_rollout.py",
    "orchestrator/episodes/test_episode_runner.py",
    "orchestrator/kit/policy/test_check.py",
)
"""Tests of every room that need nothing but the wheel."""
PROJECTS = {
    path.parent.name: tomllib.loads(path.read_text(encoding="utf-8"))["project"]
    for path in (ROOT / "pyproject.toml", ROOT / "mergevla" / "pyproject.toml")
}
CORE = [Requirement(text) for text in PROJECTS[ROOT.name]["dependencies"]]
TORCH = [
    Requirement(text)
    for text in (*PROJECTS["mergevla"]["dependencies"], *PROJECTS[ROOT.name]["optional-dependencies"]["maniskill"])
    if Requirement(text).name == "torch"
]
LAB = dict(
    line.split("==")
    for line in (ROOT / "tests" / "data" / "lab.txt").read_text(encoding="utf-8").splitlines()
    if not line.startswith("#")
)
"""Packages of a lab's environment with their versions: numpy 2, torch 2.7, pandas 2.2, LeRobot, openpi-client."""
LOWEST = (
    *LIGHT,
    *("results/store/test_episode_store.py", "results/test_run_document.py"),
    *("policies/remote/test_client.py", "policies/remote/test_vllm_omni.py"),
    *("orchestrator/ray_runtime/test_session.py", "orchestrator/inference/test_planned_policy.py"),
    *("orchestrator/cli/test_start.py", "orchestrator/cli/test_serve.py"),
)
"""Tests of what has needed a newer version of something."""
WITHOUT = (
    "tests/orchestrator/kit/policy/test_check.py::test_a_policy_without_images_has_no_findings_about_them",  # PyBullet
    "tests/suites/test_schema.py::test_a_shipped_suite_is_valid",  # some need MergeVLA
    "tests/orchestrator/cli/test_serve.py::test_an_invalid_policy_or_address_is_one_line",  # it has MergeVLA's words
    "tests/orchestrator/cli/test_start.py::test_help_takes_less_than_half_a_second_of_cpu",  # modules are not compiled
)


def lowest(requirement):
    """The lowest version of a requirement as pip writes it."""
    (bound,) = (part.version for part in requirement.specifier if part.operator == ">=")
    return f"{requirement.name}=={bound}"


def run(*command, **options):
    done = subprocess.run([*map(str, command)], capture_output=True, text=True, check=False, **options)
    assert done.returncode == 0, f"{command}\n{done.stdout[-3000:]}\n{done.stderr[-3000:]}"
    return done.stdout


def copy_repository(folder):
    """Copy the files in git, as they are now."""
    for name in run("git", "ls-files", "-co", "--exclude-standard", cwd=ROOT).splitlines():
        if (ROOT / name).exists():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name, follow_symlinks=False)
    return folder


@pytest.fixture(scope="module")
def wheels(tmp_path_factory):
    """The wheels of the program, MergeVLA and the zoo, built from the files in git."""
    source, dist = copy_repository(tmp_path_factory.mktemp("source")), tmp_path_factory.mktemp("dist")
    run(
        *(sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"),
        *("--wheel-dir", dist, ".", "./mergevla", "./zoo"),
        cwd=source,
    )
    return [next(dist.glob(f"{name}-*.whl")) for name in ("robogauntlet", "robogauntlet_mergevla", "robogauntlet_zoo")]


@pytest.fixture(scope="module")
def environment(tmp_path_factory):
    """A new environment of Python, for the action."""
    return new_environment(tmp_path_factory.mktemp("environment"))


def new_environment(folder):
    """Make an environment with the pip of this one: the pip that Python brings takes three times as long."""
    run(sys.executable, "-m", "venv", "--without-pip", folder)
    (there,) = folder.glob("lib/python*/site-packages")
    for pattern in ("pip", "pip-*.dist-info"):
        (part,) = Path(pip.__file__).parents[1].glob(pattern)
        shutil.copytree(part, there / part.name)
    return folder


@pytest.fixture(scope="module")
def runner(environment, tmp_path_factory):
    """A runner of a code host, after the action has installed itself into the environment."""
    folder = tmp_path_factory.mktemp("runner")
    runner = HostedRunner(folder, folder / "bin")
    write_program(folder / "bin" / "sudo", 'exec "$@"')
    (folder / "bin" / "robogauntlet").unlink()
    runner.environment["PATH"] = f"{environment / 'bin'}:{runner.environment['PATH']}"
    runner.environment["GITHUB_ACTION_PATH"] = str(copy_repository(tmp_path_factory.mktemp("action")))
    runner.environment["PIP_COMPILE"] = "0"  # compiling all modules would take most of the time
    runner.environment.pop("PYTHONPATH")
    code, output, _ = runner.run_step("install")
    assert code == 0, output
    return runner


@pytest.fixture(scope="module")
def program(wheels, tmp_path_factory):
    """`robogauntlet` of its own wheel, with the newest packages that it allows and no MergeVLA."""
    python = new_environment(tmp_path_factory.mktemp("newest")) / "bin" / "python"
    wanted = (f"robogauntlet[pybullet] @ {wheels[0].as_uri()}", "pytest", "hypothesis")
    run(python, "-m", "pip", "install", "--quiet", "--no-compile", *wanted)
    return python.with_name("robogauntlet")


def test_the_program_is_light_and_carries_its_data_but_no_tests_and_no_weights(wheels):
    program, mergevla, zoo = (zipfile.ZipFile(path).namelist() for path in wheels)
    for package, names in (("robogauntlet", program), ("robogauntlet_mergevla", mergevla)):
        tops = {name.split("/")[0] for name in names}
        assert tops == {package, next(top for top in tops if top.endswith(".dist-info"))}
        assert f"{package}/py.typed" in names
    for name in (
        *(f"suites/{path.name}" for path in (ROOT / "suites").glob("*.yaml")),
        "adapters/metaworld/tasks.yaml",
        "results/report/report.css",
        "orchestrator/kit/template/policy/toypolicy.py",
    ):
        assert f"robogauntlet/{name}" in program
    for name in ("LICENSE", "NOTICE"):
        assert [path for path in program if path.endswith(f".dist-info/licenses/{name}")]
    assert not [name for name in program if name.endswith(".safetensors")]
    assert wheels[0].stat().st_size < 2_000_000
    assert sum(name.endswith("model.safetensors") for name in zoo) == 18


def test_a_checkout_without_links_makes_no_wheel(tmp_path):
    for name in ("pyproject.toml", "setup.py", "README.md", "LICENSE", "NOTICE"):
        shutil.copy2(ROOT / name, tmp_path / name)
    package = tmp_path / "src" / "robogauntlet"
    package.mkdir(parents=True)
    (package / "suites").write_text("../../suites")  # as git writes a link with core.symlinks=false
    build = (sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", ".")
    done = subprocess.run(build, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 1
    assert "run git config core.symlinks true, and git checkout -- src" in done.stderr
    assert not list(tmp_path.glob("*.whl"))


@pytest.mark.nightly
def test_the_action_installs_into_a_new_python(runner, environment):
    (runner.folder / "suite.yaml").write_text("name: two\npolicies: [oracle]\ntasks: [null/Reach]\nseeds: {count: 2}\n")
    code, output, _ = runner.run_script("command -v robogauntlet && robogauntlet plan --check suite.yaml")
    assert code == 0, output
    assert output.startswith(f"{environment / 'bin' / 'robogauntlet'}\n")
    assert "suite.yaml: valid, 2 episodes" in output


@pytest.mark.nightly
def test_every_verb_has_help(program, tmp_path):
    assert int(run(program.with_name("python"), "-c", HELP, cwd=tmp_path)) > 40


@pytest.mark.nightly
def test_light_tests_of_every_room_pass_with_the_newest_packages(program):
    python, variables = program.with_name("python"), {**os.environ, "PYTHONDONTWRITEBYTECODE": ""}
    numpy, pandas = json.loads(run(python, "-c", VERSIONS))
    assert Version(numpy) >= Version("2.3")
    assert Version(pandas) >= Version("3")
    options = ("-q", "-p", "no:cacheprovider", "-m", "not simulator and not ray and not slow")
    options += ("--deselect", "tests/suites/test_schema.py::test_a_shipped_suite_is_valid")  # some need MergeVLA
    printed = run(python, "-m", "pytest", *options, *(f"tests/{name}" for name in LIGHT), cwd=ROOT, env=variables)
    assert "skipped" not in printed.splitlines()[-1]


@pytest.mark.nightly
def test_every_shipped_suite_is_valid_where_few_simulators_are_installed(program, wheels, tmp_path):
    python, others, suites = program.with_name("python"), tmp_path / "others", (ROOT / "suites").glob("*.yaml")
    run(python, "-m", "pip", "install", "--quiet", "--no-compile", "--no-deps", "--target", others, *wheels[1:])
    variables = {**os.environ, "PYTHONPATH": str(others)}
    run(python, "-c", VALIDATE, *sorted(path.stem for path in suites), cwd=tmp_path, env=variables)


@pytest.mark.nightly
def test_the_program_has_neither_torch_nor_mergevla(program, tmp_path):
    absent = "from importlib.util import find_spec; print([*map(find_spec, ('torch', 'robogauntlet_mergevla'))])"
    assert run(program.with_name("python"), "-c", absent) == "[None, None]\n"
    refused = subprocess.run([program, "plan", "mergevla"], capture_output=True, text=True, cwd=tmp_path, check=False)
    assert refused.returncode == 2
    assert "policy 'mergevla-merged' is not installed" in refused.stderr


def follow_quick_start(folder, run_program, run_python):
    """Do what README's section says, and check what it prints."""
    page = (ROOT / "README.md").read_text(encoding="utf-8")
    section = page.partition("\n## Quick start\n")[2].partition("\n## ")[0]
    printed = ""
    for language, text in re.findall(r"^```(\w*)\n(.*?)^```$", section, re.MULTILINE | re.DOTALL):
        if language == "yaml":
            (folder / text.split()[1]).write_text(text)
        elif language == "python":
            (folder / "quick.py").write_text(text)
            printed += run_python("quick.py")
        for line in text.splitlines() if not language else ():
            if "robogauntlet" in (words := shlex.split(line.removeprefix("$ ")))[:1]:
                printed += run_program(*words[1:])
    for number in (10, 40):
        assert f"{number} of {number} episodes" in printed
    assert re.search(r"act pybullet/PandaReach-v3\s+clean\s+0\.90", printed)
    assert (folder / "runs" / "first" / "report.html").is_file()


@pytest.mark.simulator
@pytest.mark.ray
@pytest.mark.usefixtures("ray_here", "room_for_one")
def test_the_quick_start_is_followed_word_by_word(run_command, tmp_path, capsys):
    def run_python(name):
        capsys.readouterr()
        runpy.run_path(name, run_name="__main__")
        return capsys.readouterr().out

    follow_quick_start(tmp_path, lambda *words: run_command(*words).out, run_python)


@pytest.mark.nightly
@pytest.mark.simulator
def test_the_quick_start_is_followed_in_a_new_environment(program, tmp_path):
    python = program.with_name("python")
    follow_quick_start(
        tmp_path, lambda *words: run(program, *words, cwd=tmp_path), lambda name: run(python, name, cwd=tmp_path)
    )


@pytest.mark.nightly
@pytest.mark.simulator
def test_all_that_the_quick_start_installs_works(program, tmp_path):
    assert "everything that is installed works" in run(program, "check", "installation", cwd=tmp_path)


def test_no_requirement_excludes_what_a_lab_has():
    versions = {canonicalize_name(name): version for name, version in LAB.items()}
    shared = [one for one in (*CORE, *TORCH) if canonicalize_name(one.name) in versions]
    assert {"numpy", "pandas", "pillow", "pydantic", "pyarrow", "torch"} <= {one.name for one in shared}
    for one in shared:
        assert one.specifier.contains(versions[canonicalize_name(one.name)]), one


def test_the_program_asks_for_no_torch_and_bounds_few_packages_from_above():
    assert "torch" not in {one.name for one in CORE}
    above = [one.name for one in (*CORE, *TORCH) if {part.operator for part in one.specifier} - {">="}]
    assert above == ["cronsim"]


@pytest.mark.nightly
def test_pip_moves_no_package_of_a_lab(wheels, tmp_path):
    python = new_environment(tmp_path / "lab") / "bin" / "python"
    (there,) = (tmp_path / "lab").glob("lib/python*/site-packages")
    for name, version in LAB.items():
        folder = there / f"{name.replace('-', '_')}-{version}.dist-info"
        folder.mkdir()
        (folder / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
        (folder / "INSTALLER").write_text("pip\n")
    report = tmp_path / "report.json"
    run(python, "-m", "pip", "install", "--quiet", "--dry-run", "--report", report, wheels[0])
    new = [one["metadata"]["name"] for one in json.loads(report.read_text())["install"]]
    assert "robogauntlet" in new
    assert {*map(canonicalize_name, new)} & {*map(canonicalize_name, LAB)} == set()


@pytest.mark.nightly
@pytest.mark.ray
def test_light_tests_of_every_room_and_a_run_pass_with_the_lowest_packages(wheels, tmp_path):
    python, pins = new_environment(tmp_path / "lowest") / "bin" / "python", tmp_path / "lowest.txt"
    pins.write_text("\n".join(map(lowest, CORE)))
    wanted = f"robogauntlet[postgresql] @ {wheels[0].as_uri()}"
    tools = ("pytest", "hypothesis", "gymnasium", "httpx2", "pyzmq", "json-numpy")
    run(python, "-m", "pip", "install", "--quiet", "--no-compile", "-c", pins, wanted, *tools)
    frozen = run(python, "-m", "pip", "freeze", "--all").lower()
    assert f"numpy=={CORE[0].specifier}".replace("==>=", "==") in frozen
    options = ("-q", "-p", "no:cacheprovider", "-m", "not simulator and not slow")
    options += tuple(word for test in WITHOUT for word in ("--deselect", test))
    printed = run(python, "-m", "pytest", *options, *(f"tests/{name}" for name in LOWEST), cwd=ROOT)
    assert "skipped" not in printed.splitlines()[-1]
    play = ("run", "--policy", "oracle", "--task", "null/Reach", "--seeds", "4", "--out", tmp_path / "run")
    assert "4 of 4 episodes" in run(python.with_name("robogauntlet"), *play, cwd=tmp_path)
