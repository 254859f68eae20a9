"""Environments, in a suite or in the configuration."""

import pytest

from robogauntlet.suites.environments import Config, EnvironmentEntry
from robogauntlet.suites.loading import SuiteError, load_config


def problem(tmp_path, text):
    path = tmp_path / "config.yaml"
    path.write_text(text)
    with pytest.raises(SuiteError) as caught:
        load_config(path, ["libero", "maniskill"], ["libero"])
    return str(caught.value).removeprefix(f"{path}:")


@pytest.mark.parametrize("text", ["", "# nothing yet\n", "environments: {}\n"])
def test_a_configuration_may_be_empty(tmp_path, text):
    (tmp_path / "config.yaml").write_text(text)
    assert load_config(tmp_path / "config.yaml", []) == Config()


def test_a_version_of_python_may_be_written_as_a_number(tmp_path):
    (tmp_path / "config.yaml").write_text("environments: {libero: {python: 3.11, requirements: [hf-libero==0.1.4]}}\n")
    entry = load_config(tmp_path / "config.yaml", ["libero"]).environments["libero"]
    assert entry == EnvironmentEntry(python="3.11", requirements=("hf-libero==0.1.4",))


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ("{python: 3.1}", 'libero.python: expected a version such as "3.11", in quotes, found a number (3.1)'),
        ("{pyton: '3.11'}", "unknown key 'pyton'; did you mean 'python'?"),
        ("{requirements: ['--index-url=x']}", "expected a requirement of pip, such as robosuite==1.4.0, and no option"),
        ("{requirements: robosuite}", "found text ('robosuite')"),
        ("{interpreter: python3}", "expected the full path of a Python interpreter, found text ('python3')"),
        ("{interpreter: /x, inherit: true}", "expected an interpreter alone, or a definition without one"),
        ("{installer: uv}", "expected inherit: false with uv, which ignores inherited packages"),
        ("{installer: conda}", "expected 'pip' or 'uv', found 'conda'"),
    ],
)
def test_a_mistake_is_reported_with_its_line(tmp_path, entry, message):
    found = problem(tmp_path, f"environments:\n  libero: {entry}\n")
    assert found.startswith("2: ")
    assert message in found


def test_an_unknown_simulator_is_answered_with_the_nearest(tmp_path):
    assert problem(tmp_path, "environments: {libro: {}}\n") == "1: unknown simulator 'libro'; did you mean 'libero'?"


@pytest.mark.parametrize(
    ("assets", "message"),
    [
        ("{libro: /x}", "no simulator that finds assets of yours: 'libro'; did you mean 'libero'?"),
        ("{maniskill: /x}", "no simulator that finds assets of yours: 'maniskill'"),
        ("{libero: here}", "expected the full path of a folder, found text ('here')"),
        ("{libero: 3}", "assets.libero: expected a valid string, found a whole number (3)"),
        ("/x", "expected a mapping"),
    ],
)
def test_a_mistake_about_assets_is_one_line(tmp_path, assets, message):
    found = problem(tmp_path, f"assets: {assets}\n")
    assert message in found
    assert "\n" not in found


def test_a_default_that_is_given_does_not_change_the_hash():
    assert EnvironmentEntry(inherit=True).hash == EnvironmentEntry().hash
    assert EnvironmentEntry(inherit=False).hash != EnvironmentEntry().hash
