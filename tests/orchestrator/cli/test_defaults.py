"""Defaults of options in the user's configuration file."""

import json

import pytest

SUITE = "name: s\npolicies: [oracle, zero]\ntasks: [null/Reach]\nseeds: {count: 5}\n"


@pytest.fixture
def planned(run_command, tmp_path, monkeypatch):
    """Plans a suite with a configuration, and returns the result of the command."""

    def run(config, *arguments):
        (tmp_path / "config.yaml").write_text(config)
        (tmp_path / "suite.yaml").write_text(SUITE)
        monkeypatch.setenv("ROBOGAUNTLET_CONFIG", str(tmp_path / "config.yaml"))
        return run_command("plan", "suite.yaml", *arguments)

    return run


def test_an_option_has_the_configured_default_which_the_command_line_overrides(planned):
    config = "defaults: {plan: {seeds: 2, policy: [zero], json: true}}\n"
    assert json.loads(planned(config).out)["to_play"] == 2
    assert json.loads(planned(config, "--seeds", "3").out)["to_play"] == 3


def test_a_verb_of_a_group_has_defaults(planned):
    assert planned("defaults: {axes: {show: {}}}\n").code == 0


@pytest.mark.parametrize(
    ("config", "problem"),
    [
        ("defaults: {plna: {seeds: 2}}", "no verb 'plna'; did you mean 'plan'?"),
        ("defaults: {plan: {sedes: 2}}", "'plan' has no 'sedes'; did you mean 'seeds'?"),
        ("defaults: {plan: 3}", "expected"),
        ("defualts: {}", "unknown key 'defualts'; did you mean 'defaults'?"),
    ],
)
def test_a_mistake_is_one_clear_line(planned, config, problem):
    result = planned(config)
    assert result.code == 2
    assert problem in result.refusal
