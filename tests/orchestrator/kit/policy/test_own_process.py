"""What a policy that is checked gets in its own process: tokens of policy servers, limited time, no other secret."""

import os

from robogauntlet.orchestrator.episodes.policy_source import PolicySource
from robogauntlet.orchestrator.kit.policy import own_process
from robogauntlet.orchestrator.kit.policy.own_process import run_apart
from robogauntlet.policies.contract import PolicyError
from robogauntlet.support.secret_variables import POLICY_TOKEN
from tests.errors import one_line_error


def variables(policy):
    return dict(os.environ)


def test_a_policy_that_is_checked_has_the_tokens_of_policy_servers_and_no_other_secret(monkeypatch):
    given = {POLICY_TOKEN: "one", f"{POLICY_TOKEN}_B": "two", "GITHUB_TOKEN": "three", "ROBOGAUNTLET_TOKEN": "four"}
    for name, value in given.items():
        monkeypatch.setenv(name, value)
    seen = run_apart(variables, PolicySource("random"))
    assert {name: seen[name] for name in given if name in seen} == {POLICY_TOKEN: "one", f"{POLICY_TOKEN}_B": "two"}


def test_a_module_that_hangs_is_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr(own_process, "LOADING_S", 2.0)
    (tmp_path / "checked_apart.py").write_text("while True: pass")
    source = PolicySource("python", {"callable": "checked_apart:act", "folder": str(tmp_path)})
    with one_line_error(PolicyError, "expected the policy to be built within 2 s, got none; find out where it hangs"):
        run_apart(variables, source)
