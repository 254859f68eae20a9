"""What a policy that is checked gets in its own process: tokens of policy servers, limited time, no other secret."""

import json
import sys

from robogauntlet.orchestrator.environments.source_path import import_path
from robogauntlet.orchestrator.episodes.policy_source import PolicySource
from robogauntlet.orchestrator.kit.policy import check
from robogauntlet.policies.contract import PolicyError
from robogauntlet.support.secret_variables import POLICY_TOKEN
from tests.errors import one_line_error


def check_module(folder, text):
    (folder / "checked_apart.py").write_text(text)
    source = PolicySource("python", {"callable": "checked_apart:act", "folder": str(folder)})
    return list(check.check_policy(check.Probe("apart", source, "null/Reach")))


def test_a_policy_that_is_checked_has_the_tokens_of_policy_servers_and_no_other_secret(tmp_path, monkeypatch):
    given = {POLICY_TOKEN: "one", f"{POLICY_TOKEN}_B": "two", "GITHUB_TOKEN": "three", "ROBOGAUNTLET_TOKEN": "four"}
    for name, value in given.items():
        monkeypatch.setenv(name, value)
    seen = tmp_path / "seen.json"
    text = f"import json, os\nopen({str(seen)!r}, 'w').write(json.dumps(dict(os.environ)))\nos._exit(0)\n"
    (finding,) = check_module(tmp_path, text)
    assert str(finding) == "answer: failed: the policy ended its process"
    variables = json.loads(seen.read_text())
    assert {name: variables[name] for name in given if name in variables} == {
        POLICY_TOKEN: "one",
        f"{POLICY_TOKEN}_B": "two",
    }


def test_a_policy_is_checked_in_the_environment_of_the_simulator(tmp_path, monkeypatch):
    (tmp_path / "config.yaml").write_text(f"environments: {{'null': {{interpreter: {sys.executable}}}}}\n")
    monkeypatch.setenv("ROBOGAUNTLET_CONFIG", str(tmp_path / "config.yaml"))
    text = f"import os, sys\nif {str(import_path())!r} == os.environ['PYTHONPATH']:\n    os._exit(0)\n"
    (finding,) = check_module(tmp_path, text)
    assert finding.text == "the policy ended its process"


def test_a_process_that_has_forked_is_seen_to_end(tmp_path):
    (finding,) = check_module(tmp_path, "import os, time\nif os.fork():\n    os._exit(0)\ntime.sleep(60)\n")
    assert finding.text == "the policy ended its process"


def test_a_module_that_hangs_is_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr(check, "LOADING_S", 2.0)
    with one_line_error(PolicyError, "expected the policy to be built within 2 s, got none; find out where it hangs"):
        check_module(tmp_path, "while True: pass")
