"""A policy that is checked in a process of its own has the tokens of policy servers, and no other secret."""

import os

from robogauntlet.orchestrator.policy_kit.own_process import run_apart
from robogauntlet.support.secret_variables import POLICY_TOKEN


def variables():
    return dict(os.environ)


def test_a_policy_that_is_checked_has_the_tokens_of_policy_servers_and_no_other_secret(monkeypatch):
    given = {POLICY_TOKEN: "one", f"{POLICY_TOKEN}_B": "two", "GITHUB_TOKEN": "three", "ROBOGAUNTLET_TOKEN": "four"}
    for name, value in given.items():
        monkeypatch.setenv(name, value)
    seen = run_apart(variables)
    assert {name: seen[name] for name in given if name in seen} == {POLICY_TOKEN: "one", f"{POLICY_TOKEN}_B": "two"}
