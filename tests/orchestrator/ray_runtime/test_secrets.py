"""Where a policy of others runs, there are none of the user's secrets."""

import sys
import time

import psutil
import pytest

from robogauntlet.orchestrator.episodes.policy_source import PolicySource, given_variables
from robogauntlet.orchestrator.schedules.runner import LOG_FILE, begin
from robogauntlet.orchestrator.schedules.schedule import SCHEDULE_VARIABLE, Schedule
from robogauntlet.policies import catalog
from robogauntlet.policies.contract import PolicyError
from robogauntlet.results.store.database import file_url
from robogauntlet.support.child_process import JsonChild
from robogauntlet.support.secret_variables import POLICY_TOKEN, RUN_SECRETS, SECRETS, SERVER_SECRETS, without_secrets

POLICY = """
import os
import pathlib

def look(images, proprioception, instruction):
    raylet = pathlib.Path(f"/proc/{os.getppid()}/environ").read_text()
    seen = repr(dict(os.environ)) + pathlib.Path("/proc/self/environ").read_text() + raylet
    pathlib.Path(os.environ["SEEN"]).write_text(seen)
    return [[0.0] * 7]
"""
OTHERS = (
    "AWS_SECRET_ACCESS_KEY",
    "GITHUB_TOKEN",
    "HF_TOKEN",
    "OPENAI_API_KEY",
    "SLURM_JWT",
    "A_NAME_THAT_NOBODY_KNOWS",
)
"""Variables of other programs."""
ENVIRON = "from robogauntlet.support.child_process import serve\nimport os\nserve(lambda _: dict(os.environ))"


@pytest.fixture
def secrets(monkeypatch):
    """Secrets in this process's environment, but for the URLs of databases."""
    urls = {"ROBOGAUNTLET_STORE", "ROBOGAUNTLET_HISTORY"}
    names = (*SECRETS, *OTHERS, POLICY_TOKEN, f"{POLICY_TOKEN}_B")
    values = {name: f"geheim-{name}" for name in names if name not in urls}
    for name, value in values.items():
        monkeypatch.setenv(name, value)
    return values


def test_a_child_process_gets_no_secret(secrets):
    with JsonChild([sys.executable, "-c", ENVIRON]) as child:
        seen = child.ask(None, 20.0)
    assert "PATH" in seen
    assert not any("geheim" in value for value in seen.values())


def test_what_programs_and_renderers_read_stays_and_all_else_goes_unless_it_is_named():
    stays = {
        "PATH": "x",
        "LC_ALL": "C",
        "CUDA_VISIBLE_DEVICES": "0",
        "SLURM_JOB_ID": "7",
        "https_proxy": "http://a:b@c",
    }
    stays |= {"TOKENIZERS_PARALLELISM": "false", "RAY_AUTH_TOKEN": "t", "ROBOGAUNTLET_VARIABLES": "MY_ASSETS, OTHER"}
    stays |= {"PIP_INDEX_URL": "https://index/simple", "MY_ASSETS": "y"}
    goes = {"MY_DATA": "y", POLICY_TOKEN: "z", "UV_INDEX_URL": "https://me:geheim@index/simple", "CONDA_TOKEN": "z"}
    assert without_secrets({**stays, **goes}) == stays
    assert without_secrets(goes, but=["MY_DATA"]) == {"MY_DATA": "y"}


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("PIP_INDEX_URL", "https://geheim@index/simple"),
        ("PIP_EXTRA_INDEX_URL", "https://index/simple https://me:ge/he#im@other/simple"),
        ("UV_INDEX", "own=https://me:@index/simple"),
        ("UV_INDEX_OWN_USERNAME", "geheim"),
        ("NIX_CONFIG", "access-tokens = github.com=geheim"),
        ("PBS_JOBCOOKIE", "geheim"),
        ("TF_VAR_db", "geheim"),
        ("CONDA_CHANNEL_PAT", "geheim"),
    ],
)
def test_a_known_programs_variable_that_holds_a_secret_goes(name, value):
    assert without_secrets({name: value}) == {}


@pytest.mark.parametrize("given", [7, "A=B", ["A", 1], {"A": "B"}, ["$A"], [""]])
def test_a_policy_that_names_no_variables_is_refused_in_one_line(given, tmp_path):
    (tmp_path / "looking.py").write_text(POLICY)
    with pytest.raises(PolicyError, match=r"option variables: expected names .* such as \[HF_TOKEN\], got") as error:
        catalog.load("python", {"callable": "looking:look", "folder": str(tmp_path), "variables": given})
    assert "\n" not in str(error.value)


def test_the_variables_of_a_policy_are_shown_by_name_and_are_no_part_of_its_content(secrets, tmp_path):
    (tmp_path / "looking.py").write_text(POLICY)
    options = {"callable": "looking:look", "folder": str(tmp_path)}
    source = PolicySource("python", {**options, "variables": ["HF_TOKEN", "NOT_SET"]})
    assert [*given_variables({"p": source})] == ["policy p gets the environment variables HF_TOKEN"]
    assert "geheim" not in repr(source)
    assert catalog.digest("python", source.options) == catalog.digest("python", options)


@pytest.mark.ray
@pytest.mark.parametrize("inference", ["worker", pytest.param("served", marks=pytest.mark.nightly)])
def test_a_scheduled_run_and_its_workers_have_only_what_they_need(secrets, tmp_path, monkeypatch, inference):
    (tmp_path / "looking.py").write_text(POLICY)
    options = f"{{callable: 'looking:look', folder: {tmp_path}, variables: [SEEN, HF_TOKEN]}}"
    (tmp_path / "suite.yaml").write_text(
        f"name: s\npolicies: [{{name: p, kind: python, options: {options}}}]\ntasks: [null/Reach]\nhorizon: 4\n"
        f"seeds: {{count: 1}}\nworkers: 1\ninference: {{place: {inference}}}\n"
    )
    monkeypatch.setenv("SEEN", str(tmp_path / "seen"))
    suite = str(tmp_path / "suite.yaml")
    schedule = Schedule(name="nightly", suite=suite, cron="@daily", arguments=["--no-media"])
    begun = begin(schedule, tmp_path / "run", file_url(tmp_path / "history.sqlite"))
    try:
        while SCHEDULE_VARIABLE not in (its := psutil.Process(begun.pid).environ()):
            time.sleep(0.01)  # until the new process has replaced the copy of this one
        assert begun.wait(120) == 0, (tmp_path / "run" / LOG_FILE).read_text()
    finally:
        begun.kill()
    assert not set(SERVER_SECRETS) & set(its)
    assert "policy p gets the environment variables SEEN, HF_TOKEN" in (tmp_path / "run" / LOG_FILE).read_text()
    assert {name for name in RUN_SECRETS if "geheim" in its.get(name, "")} == set(RUN_SECRETS) & set(secrets)
    seen = (tmp_path / "seen").read_text()
    found = [name for name, value in secrets.items() if value in seen and not name.startswith(POLICY_TOKEN)]
    assert found == ["HF_TOKEN"]
    assert "history.sqlite" not in seen
