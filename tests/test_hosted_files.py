"""What a code host reads: workflows, the action, the hook and the forms. Steps are run as they are."""

import json
import re
import shlex
import sqlite3
import tomllib

import pytest
import yaml

from tests import ROOT
from tests.hosted_actions import HostedRunner, action_steps, load, write_program
from tests.jobs import JOBS

OURS = tuple(f".github/workflows/{name}.yml" for name in ("ci", "studies", *JOBS))
WORKFLOWS = (*OURS, "examples/github-nightly.yml")
FORMS = ("bug.yml", "feature.yml")
SUITE = """
name: nightly
policies: [oracle, random]
tasks: [null/Reach]
seeds: {count: 40}
"""
# Writes its arguments, one a line, instead of running anything.
RECORDER = "printf '%s\\n' \"$@\" >> arguments"


@pytest.fixture
def runner(tmp_path):
    (tmp_path / "suite.yaml").write_text(SUITE)
    return HostedRunner(tmp_path, tmp_path / "bin")


def steps_of(name):
    return [step for job in load(name)["jobs"].values() for step in job["steps"]]


def nightly_inputs():
    step = next(step for step in steps_of("examples/github-nightly.yml") if step.get("name") == "play and compare")
    return {**step["with"], "suite": "suite.yaml"}


@pytest.mark.ray
@pytest.mark.nightly
def test_the_nightly_workflow_passes_on_good_runs_and_fails_on_a_regression(runner, tmp_path):
    inputs = nightly_inputs()
    keep = next(step["run"] for step in steps_of("examples/github-nightly.yml") if "run" in step)
    code, output, _ = runner.run_step("play", **inputs)
    assert code == 0, output
    assert runner.run_step("compare", **inputs) == (0, "", "no baseline to compare with yet\n")
    assert runner.run_script(keep) == (0, "", "")
    assert runner.run_step("play", **inputs)[0] == 0
    code, _, summary = runner.run_step("compare", **inputs)
    assert code == 0
    assert "### ✅ no evidence of a difference" in summary
    with sqlite3.connect(tmp_path / "runs" / "now" / "episodes.sqlite") as database:
        database.execute("update episodes set status = 'failure' where policy = 'oracle' and seed < 12")
    code, _, summary = runner.run_step("compare", **inputs)
    assert code == 1
    assert "oracle, null/Reach: 100 % before, 70 % now of 40 episodes, -30.0 [" in summary


@pytest.mark.nightly
@pytest.mark.ray
def test_the_action_plays_the_policy_and_the_options_that_it_is_given(runner, tmp_path):
    code, output, _ = runner.run_step(
        "play", suite="suite.yaml", policy="zero", arguments="--seeds 3 --no-media", out="runs/some where"
    )
    assert code == 0, output
    with sqlite3.connect(tmp_path / "runs" / "some where" / "episodes.sqlite") as database:
        assert database.execute("select policy, count(*) from episodes group by policy").fetchall() == [("zero", 3)]


@pytest.mark.parametrize("text", ["$(touch here)", "`touch here`", "'; touch here; '", '"; touch here; "', "a b"])
def test_an_input_of_the_action_is_a_word_and_is_never_run(runner, tmp_path, text):
    write_program(tmp_path / "bin" / "robogauntlet", RECORDER)
    runner.run_step("play", suite=text, policy=text, out=text, arguments=shlex.join(["--seeds", text]))
    words = (tmp_path / "arguments").read_text().splitlines()
    assert words == ["run", "--seeds", text, "--policy", text, "--out", text, "--", text]
    (tmp_path / "base line").mkdir()
    runner.run_step("compare", baseline="base line", out=text)
    assert (tmp_path / "arguments").read_text().splitlines()[-3:] == ["--", text, "base line"]
    assert not (tmp_path / "here").exists()


@pytest.mark.parametrize(
    ("extra", "packages"),
    [
        ("", [""]),
        ("pybullet", ["[pybullet]"]),
        ("a,b", ["[a,b]"]),
        ("mergevla", ["", "/mergevla", "/zoo"]),
        ("simulators,mergevla", ["[simulators]", "/mergevla", "/zoo"]),
        ("mergevla,b", ["[b]", "/mergevla", "/zoo"]),
        ("a,mergevla,b", ["[a,b]", "/mergevla", "/zoo"]),
    ],
)
def test_the_action_installs_itself_with_its_extras_and_pins(runner, tmp_path, extra, packages):
    for program in ("python", "sudo"):
        write_program(tmp_path / "bin" / program, RECORDER)
    assert runner.run_step("install", extra=extra)[0] == 0
    drivers, words = ["bash", f"{ROOT}/scripts/render_drivers.sh"], (tmp_path / "arguments").read_text().splitlines()
    assert words[:2] == drivers
    pinned = ["-c", f"{ROOT}/constraints.txt", *(f"{ROOT}{package}" for package in packages)]
    assert words[-len(pinned) :] == pinned
    assert all((ROOT / name).is_file() for name in ("scripts/render_drivers.sh", "constraints.txt"))


def test_the_action_refuses_an_extra_that_is_a_requirement(runner):
    code, output, _ = runner.run_step("install", extra="x] @ file:///elsewhere")
    assert code == 2
    assert output.startswith("extra: expected names of extras with commas between them, got 'x] @ file")


def test_the_extras_of_the_nightly_workflow_exist():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    assert set(nightly_inputs()["extra"].split(",")) <= {*extras, "mergevla"}


def test_no_script_has_an_expression_in_it():
    scripts = [step["run"] for step in action_steps().values()]
    scripts += [step["run"] for name in WORKFLOWS for step in steps_of(name) if "run" in step]
    assert len(scripts) > 5
    assert [script for script in scripts if "${{" in script] == []


@pytest.mark.parametrize("name", WORKFLOWS)
def test_a_workflow_may_only_read_and_is_given_no_secret(name):
    assert load(name)["permissions"] == {"contents": "read"}
    assert not [job for job in load(name)["jobs"].values() if "permissions" in job]
    assert "secrets." not in (ROOT / name).read_text()


def test_hosted_ci_calls_what_a_developer_calls_and_uploads_nothing():
    workflow, steps = load(".github/workflows/ci.yml"), steps_of(".github/workflows/ci.yml")
    assert set(workflow[True]) == {"push", "pull_request"}
    assert ".ci/run" in [step.get("run") for step in steps]
    assert "make test" in (ROOT / ".ci" / "run").read_text()
    uses = {step["uses"].partition("@")[0] for step in steps if "uses" in step}
    assert uses == {"actions/checkout", "actions/setup-python"}
    versions = [step["with"]["python-version"] for step in steps if "setup-python" in step.get("uses", "")]
    assert set(versions) == {"3.11"}
    assert "make audit" in [step.get("run") for step in steps]


@pytest.mark.parametrize("name", OURS)
def test_a_workflow_runs_only_scripts_and_targets_that_exist(name):
    targets = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    for step in steps_of(name):
        words = step.get("run", "").split()
        if "make" in words:
            assert words[-1] in targets
        elif words:
            assert any((ROOT / word).is_file() for word in words)


@pytest.mark.parametrize("job", JOBS)
def test_a_job_has_a_command_and_a_workflow_that_starts_it_at_times(job):
    assert f"--whole --job {job}" in (ROOT / "Makefile").read_text()
    workflow = load(f".github/workflows/{job}.yml")
    assert workflow[True]["schedule"]
    assert any(step.get("run", "").endswith(f"make {job}") for step in steps_of(f".github/workflows/{job}.yml"))


@pytest.mark.parametrize("name", FORMS)
def test_an_issue_form_has_what_the_host_requires(name):
    form = load(f".github/ISSUE_TEMPLATE/{name}")
    assert {"name", "description", "body"} <= form.keys()
    identifiers = [field["id"] for field in form["body"] if field["type"] != "markdown"]
    assert len(identifiers) == len(set(identifiers)) > 1
    for field in form["body"]:
        assert field["type"] in ("markdown", "textarea", "input", "dropdown")
        assert "value" in field["attributes"] if field["type"] == "markdown" else "label" in field["attributes"]


def test_the_code_of_conduct_names_a_contact_that_exists():
    text = (ROOT / "CODE_OF_CONDUCT.md").read_text()
    assert "private security advisories" in text
    assert "(CITATION.cff)" in text
    assert yaml.safe_load((ROOT / "CITATION.cff").read_text())["authors"]


def hook():
    (found,) = load(".pre-commit-hooks.yaml")
    return found


def test_the_hook_passes_a_good_suite_and_names_the_mistakes_of_a_bad_one(run_command, tmp_path):
    program, *words = shlex.split(hook()["entry"])
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
    assert program in scripts
    (tmp_path / "good.yaml").write_text(SUITE)
    (tmp_path / "bad.yaml").write_text(SUITE.replace("null/Reach", "null/Raech").replace("count: 40", "count: none"))
    passed = run_command(*words, "good.yaml")
    assert passed.code == 0, passed.err
    refused = run_command(*words, "good.yaml", "bad.yaml")
    assert refused.code == 2
    assert "bad.yaml" in refused.err


def test_the_hook_starts_nothing_that_a_suite_names(run_command, monkeypatch, tmp_path):
    (tmp_path / "named.py").write_text("open('imported', 'w').close()\ndef act(*values): return []\n")
    policy = json.dumps({"name": "named", "kind": "python", "options": {"callable": "named:act"}})
    (tmp_path / "suite.yaml").write_text(SUITE.replace("[oracle, random]", f"[{policy}]"))
    monkeypatch.syspath_prepend(tmp_path)
    done = run_command(*shlex.split(hook()["entry"])[1:], "suite.yaml")
    assert done.code == 0, done.err
    assert not (tmp_path / "imported").exists()


@pytest.mark.parametrize(
    ("path", "is_suite"),
    [("suites/smoke.yaml", True), ("robots/suites/a.yaml", True), ("mkdocs.yml", False), ("mysuites/a.yaml", False)],
)
def test_the_hook_is_for_files_in_a_folder_of_suites(path, is_suite):
    assert bool(re.search(hook()["files"], path)) == is_suite
