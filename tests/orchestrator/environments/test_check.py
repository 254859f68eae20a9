"""Each problem of an environment is one line before anything starts."""

import sys
import venv
from dataclasses import replace
from importlib import metadata

import pytest

from robogauntlet.adapters import catalog
from robogauntlet.orchestrator.cli.common import EXIT_BAD_INPUT
from robogauntlet.orchestrator.environments import introspect
from robogauntlet.orchestrator.environments.check import check
from robogauntlet.orchestrator.environments.environment import RUNNING, WORKER_PACKAGES, Environment
from robogauntlet.policies.contract import PolicyKind
from robogauntlet.suites.environments import EnvironmentEntry

RAY = metadata.version("ray")
SUITE = "name: s\ntasks: [null/Reach]\nseeds: {count: 1}\n"


@pytest.fixture
def theirs(simulators, tmp_path):
    """An environment that a person made, with Python alone."""
    venv.EnvBuilder(symlinks=True, with_pip=False).create(tmp_path / "theirs")
    return tmp_path / "theirs"


def problems(python, name="bare"):
    environment = Environment(name, EnvironmentEntry(interpreter=str(python)), "the suite")
    return check(environment, catalog.find(name)).problems


def install(folder, name, version):
    site = folder / "lib" / f"python{RUNNING}" / "site-packages"
    (site / f"{name}-{version}.dist-info").mkdir()
    (site / f"{name}-{version}.dist-info" / "METADATA").write_text(f"Name: {name}\nVersion: {version}\n")
    (site / f"{name}.py").touch()


def test_a_missing_environment_is_reported_with_the_command_that_creates_it(simulators):
    (problem,) = check(Environment("bare", EnvironmentEntry(), "the suite"), catalog.find("bare")).problems
    assert problem == "environment bare does not exist; create it: robogauntlet env create bare"


def test_a_missing_interpreter_is_reported(simulators):
    (problem,) = problems("/nowhere/python")
    assert problem == "environment bare: expected a Python interpreter at /nowhere/python, found none"


def test_an_empty_environment_has_a_line_for_each_problem(theirs):
    ray, needed, modules = problems(theirs / "bin" / "python")
    assert ray == f"environment bare: expected Ray {RAY} as here, it has none; install it there"
    lacking = ", ".join(WORKER_PACKAGES.values())
    assert needed == f"environment bare: expected the packages of workers, it lacks {lacking}; install it there"
    assert modules == "environment bare: expected the modules of bare, it lacks gearbox; install it there"


def test_another_version_of_ray_is_reported(theirs):
    for name in ("gearbox", *WORKER_PACKAGES.values()):
        install(theirs, name, "1.0")
    install(theirs, "ray", "2.9.0")
    (problem,) = problems(theirs / "bin" / "python")
    assert problem == f"environment bare: expected Ray {RAY} as here, it has 2.9.0; install it there"


def test_another_version_of_python_is_reported(simulators, tmp_path):
    python = tmp_path / "python"
    python.write_text(f'#!/bin/sh\nexec {sys.executable} -c "import sys; sys.version_info = (3, 99, 1)\n$2" "$3"\n')
    python.chmod(0o755)
    (problem,) = problems(python)
    assert problem.startswith(f"environment bare: expected Python {RUNNING} as here")
    assert problem.endswith("it has 3.99.1")


def test_an_entry_for_another_python_is_reported(made):
    entry = EnvironmentEntry(interpreter=sys.executable)
    other = Environment("bare", entry.model_copy(update={"python": "3.99"}), "")
    (problem,) = check(other, catalog.find("bare")).problems
    assert problem.endswith("it has 3.99")


def test_an_interpreter_that_fails_is_reported_with_its_last_line(simulators, tmp_path):
    python = tmp_path / "python"
    python.write_text("#!/bin/sh\necho 'no libc here' >&2\nexit 3\n")
    python.chmod(0o755)
    (problem,) = problems(python)
    ended = "the process ended with code 3: no libc here"
    assert problem == f"environment bare: expected an answer from {python}, got: {ended}; install it there"


def test_a_changed_package_is_reported_with_its_version(made):
    first = catalog.find("first")
    environment = Environment("first", EnvironmentEntry(requirements=("gearbox==1.0",)), "its adapter")
    entry = EnvironmentEntry(interpreter=str(environment.python))
    assert check(Environment("first", entry, ""), first).problems == ()
    lying = entry.model_copy(update={"requirements": ("gearbox==2.0",)})
    (problem,) = check(Environment("first", lying, ""), first).problems
    assert "expected gearbox==2.0, it has 1.0" in problem


def test_a_suitable_environment_has_no_problem_and_its_versions(made):
    environment = Environment("second", EnvironmentEntry(requirements=("gearbox==2.0",)), "its adapter")
    found = check(environment, catalog.find("second"))
    assert found.problem is None
    assert found.versions == {"ray": RAY, "gearbox": "2.0"}


def test_the_interpreter_of_a_policy_needs_its_modules_alone(theirs):
    kind = PolicyKind("mine", "mine", load=None, digest=None, modules=("gearbox",), without_dependencies=("gearbox",))
    environment = Environment("mine", EnvironmentEntry(interpreter=str(theirs / "bin" / "python")), "the suite")
    lacking = "environment mine: expected the modules of mine, it lacks gearbox; install it there"
    assert check(environment, kind).problems == (lacking,)
    install(theirs, "gearbox", "1.0")
    found = check(replace(environment, name="again"), replace(kind, name="again", modules=("gearbox", "json")))
    assert found.problems == ()


@pytest.mark.parametrize("imports", ["", "json.tool:main_of_gearbox", "gearbox_parts:all_of_them"])
def test_what_is_installed_and_cannot_be_imported_is_reported_with_what_is_missing(theirs, imports):
    install(theirs, "gearbox", "1.0")
    site = theirs / "lib" / f"python{RUNNING}" / "site-packages"
    lacking = "import httpx_of_gearbox\n"
    if not imports:
        (site / "gearbox.py").write_text(lacking)
    (site / "gearbox_parts.py").write_text(f"def all_of_them():\n    {lacking}")
    kind = PolicyKind("mine", "mine", load=None, digest=None, modules=("gearbox",), imports=imports)
    environment = Environment("mine", EnvironmentEntry(interpreter=str(theirs / "bin" / "python")), "the suite")
    error = "ModuleNotFoundError: No module named 'httpx_of_gearbox'"
    if imports.startswith("json"):
        error = "AttributeError: module 'json.tool' has no attribute 'main_of_gearbox'"
    (problem,) = check(environment, kind, contents=True).problems
    assert problem == f"environment mine: expected to import what mine needs, got {error}; install it there"
    assert check(environment, kind).problems == ()  # a run imports nothing twice


def test_a_package_of_workers_that_cannot_be_imported_there_is_reported(theirs):
    for name in ("gearbox", *WORKER_PACKAGES.values()):
        install(theirs, name, "1.0")
    install(theirs, "ray", RAY)
    error = "ImportError: pyarrow requires NumPy 2.0 or newer"
    pyarrow = theirs / "lib" / f"python{RUNNING}" / "site-packages" / "pyarrow.py"
    pyarrow.write_text("raise ImportError('pyarrow requires NumPy 2.0 or newer')")
    environment = Environment("bare", EnvironmentEntry(interpreter=str(theirs / "bin" / "python")), "the suite")
    (problem,) = check(environment, catalog.find("bare"), contents=True).problems
    assert problem == f"environment bare: expected to import what bare needs, got {error}; install it there"


def test_missing_files_are_reported_under_pythons_that_do_not_list_them(tmp_path, monkeypatch):
    (tmp_path / "gearbox-1.0.dist-info").mkdir()
    (tmp_path / "gearbox-1.0.dist-info" / "METADATA").write_text("Name: gearbox\nVersion: 1.0\n")
    (tmp_path / "gearbox-1.0.dist-info" / "RECORD").write_text(
        '"a, b.png",sha256=47DEQpj8HBSa-_TImW-5JCeuQeRkm5NMpJWZG3hSuFU,0\ngearbox-1.0.dist-info/RECORD,,\n'
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(metadata.Distribution, "files", ())  # as Python 3.12 does for missing ones
    assert introspect._differing("gearbox") == ["a, b.png"]


def test_damaged_files_are_reported_with_the_first(theirs):
    for name in ("gearbox", *WORKER_PACKAGES.values()):
        install(theirs, name, "1.0")
    install(theirs, "ray", RAY)
    site = theirs / "lib" / f"python{RUNNING}" / "site-packages"
    (site / "gearbox-1.0.dist-info" / "RECORD").write_text(
        "whole.png,sha256=LPJNul-wow4m6DsqxbninhsWHlwfp0JecwQzYpOLmCQ,5\n"  # of "hello"
        "short.png,sha256=LPJNul-wow4m6DsqxbninhsWHlwfp0JecwQzYpOLmCQ,5\n"
        "lost.png,sha256=LPJNul-wow4m6DsqxbninhsWHlwfp0JecwQzYpOLmCQ,5\n"
        "gearbox.py,,\n"
    )
    (site / "whole.png").write_text("hello")
    (site / "short.png").write_text("hell")
    entry = EnvironmentEntry(interpreter=str(theirs / "bin" / "python"))
    environment = Environment("bare", entry.model_copy(update={"requirements": ("gearbox==1.0",)}), "the suite")
    found = check(environment, catalog.find("bare"), contents=True).problems
    damage = "expected the files of gearbox as its wheel has them, short.png and 1 more are missing or differ"
    assert [problem for problem in found if "wheel" in problem] == [f"environment bare: {damage}; install it there"]
    assert not any("wheel" in problem for problem in check(environment, catalog.find("bare")).problems)


class TestTheCommand:
    def test_creates_shows_checks_lists_and_removes(self, simulators, run_command):
        done = run_command("env", "create", "first")
        assert done.code == 0
        assert f"first: fits: Python {RUNNING}" in done.out
        assert "first: exists: " in run_command("env", "create", "first").out
        assert '{"requirements": ["gearbox==1.0"]}' in run_command("env", "list", "first").out
        assert "gearbox 1.0" in run_command("env", "list", "first").out
        listed = run_command("env", "list").out
        assert "fits" in next(line for line in listed.splitlines() if line.startswith("first"))
        assert run_command("env", "remove", "first").out.startswith("removed ")
        assert run_command("env", "list", "first").code == 1
        assert run_command("env", "remove", "first").code == EXIT_BAD_INPUT

    def test_a_simulator_that_needs_none_says_how_to_give_it_one(self, simulators, run_command):
        line = run_command("env", "create", "bare").refusal
        assert "bare: runs in the running environment; to give it its own environment, add environments:" in line

    def test_a_misspelt_simulator_gets_a_suggestion(self, simulators, run_command):
        assert "did you mean 'second'?" in run_command("env", "create", "secund").err
        assert "null" not in run_command("env", "create", "xyz").err

    def test_a_wrong_configuration_is_one_line_in_every_verb(self, simulators, run_command, tmp_path, monkeypatch):
        config = tmp_path / "config.yaml"
        config.write_text("environments:\n  frist: {requirements: [x]}\n")
        monkeypatch.setenv("ROBOGAUNTLET_CONFIG", str(config))
        for verb in (["env", "list"], ["list", "tasks"], ["plan", "smoke"], ["check", "installation"]):
            assert run_command(*verb).refusal == f"{config}:2: unknown simulator 'frist'; did you mean 'first'?"

    def test_a_missing_configuration_file_is_one_line(self, simulators, run_command, monkeypatch):
        monkeypatch.setenv("ROBOGAUNTLET_CONFIG", "/nowhere/config.yaml")
        assert run_command("env", "list").refusal == "/nowhere/config.yaml: no such file"

    def test_a_policy_without_its_environment_is_one_line_before_anything_starts(
        self, run_command, tmp_path, monkeypatch
    ):
        (tmp_path / "suite.yaml").write_text(f"{SUITE}policies: ['lerobot:x/y']\n")
        (tmp_path / "config.yaml").write_text("environments: {lerobot: {interpreter: /nowhere/python}}\n")
        monkeypatch.setenv("ROBOGAUNTLET_CONFIG", str(tmp_path / "config.yaml"))
        reason = "expected a Python interpreter at /nowhere/python, found none"
        line = run_command("run", "suite.yaml", "--out", "run").refusal
        assert line.endswith(f"policy 'lerobot-x-y': environment lerobot: {reason}")

    @pytest.mark.parametrize("verb", [("plan", "--check"), ("plan",), ("run",)])
    @pytest.mark.parametrize(
        ("entry", "place", "name"),
        [
            ("policies: [oracle]\nenvironments: {'null': {interpreter: FILE}}", "environments", "null"),
            ("policies: [{name: p, kind: lerobot, options: {checkpoint: x/y, python: FILE}}]", "policies", "lerobot"),
        ],
    )
    def test_a_suite_names_no_program_and_none_is_started(self, run_command, tmp_path, verb, entry, place, name):
        program, marker = tmp_path / "program", tmp_path / "started"
        program.write_text(f"#!/bin/sh\ntouch {marker}\n")
        program.chmod(0o755)
        (tmp_path / "suite.yaml").write_text(SUITE + entry.replace("FILE", str(program)) + "\n")
        (line,) = run_command(*verb, "suite.yaml").refusal.splitlines()
        assert "a suite names no program" in line
        assert f"environments: {{{name}: {{interpreter: FILE}}}}` into your configuration" in line
        assert not marker.exists()
        assert sorted(path.name for path in tmp_path.iterdir()) == ["program", "suite.yaml"]
