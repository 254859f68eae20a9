"""An imported run plays nothing of its author's choice without `--trust`."""

from contextlib import closing

import pytest

from robogauntlet.orchestrator.runs import trust
from robogauntlet.orchestrator.runs.trust import chosen_parts
from robogauntlet.policies import catalog
from robogauntlet.results.record import outcome_row, rows_hash
from robogauntlet.results.run_document import read_run, store_url, write_run
from robogauntlet.results.store.episode_store import Store
from robogauntlet.results.store.run_archive import export_run
from robogauntlet.suites.episode import Cell, Protocol
from robogauntlet.suites.schema import policy_entry
from tests.results.synthetic import document, row, run_folder, suite

RUN_ID = "0123456789abcdef0123456789abcdef"


def sent(root, *policies, digest="0" * 16):
    """An exported run of these policies, as a stranger sends it."""
    entries = [policy_entry(one) if isinstance(one, str) else one for one in policies]
    of = [Cell(entry["name"], digest, "null/Reach", Protocol(horizon=20)) for entry in entries[:1]]
    results = [row(cell, seed) for cell in of for seed in range(2)]
    run = document(
        2,
        of=of,
        run_id=RUN_ID,
        name="small",
        policies=entries,
        tasks=["null/Reach"],
        rows_hash=rows_hash(map(outcome_row, results)),
        command="touch stolen",
    )
    folder = run_folder(root / "theirs", run, results)
    with closing(Store.open(store_url(folder, run), run.run_id)) as store:
        export_run(run, store, root / "run.robogauntlet")
    return root / "run.robogauntlet"


def popen(marker):
    """A policy that is a command of its author."""
    options = {"callable": "subprocess:Popen", "options": {"args": f"touch {marker}", "shell": True}}
    return {"name": "evil", "kind": "python", "options": options}


@pytest.mark.parametrize(
    "verb",
    [
        ("verify", "runs/small-01234567", "--sample", "1"),
        ("replay", "", "--run", "runs/small-01234567"),
        ("export", "runs/small-01234567", "--format", "lerobot-dataset", "--status", "success"),
        ("run", "theirs.yaml", "--out", "runs/small-01234567"),
    ],
    ids=lambda verb: verb[0],
)
def test_a_command_of_the_author_is_not_executed(run_command, tmp_path, verb):
    evil, marker = popen(tmp_path / "stolen"), tmp_path / "stolen"
    file = sent(tmp_path, evil, digest=catalog.digest("python", evil["options"]))
    assert run_command("import", file).code == 0
    if verb[0] == "replay":
        with closing(Store.open_begun(tmp_path / "runs/small-01234567", document(run_id=RUN_ID))) as store:
            verb = (verb[0], next(store.results()).episode_id, *verb[2:])
    line = run_command(*verb).refusal
    assert "policy evil imports and calls subprocess:Popen, gives it" in line
    assert str(marker) in line
    assert line.endswith("give --trust if you trust all of it")
    assert not marker.exists()


def test_all_that_a_run_would_use_is_listed_before_anything_is_used(run_command, tmp_path):
    policies = (
        {"name": "b", "kind": "openpi", "options": {"address": "ws://far:1", "token_variable": "THEIR_TOKEN"}},
        {"name": "c", "kind": "lerobot", "options": {"checkpoint": "their/folder", "python": "/tmp/py"}},
        {"name": "d", "kind": "mergevla", "options": {"checkpoint": "/etc/weights"}},
        {"name": "f", "kind": "replay", "options": {"demonstrations": "/data/theirs"}},
        {"name": "e", "kind": "another-package's", "options": {"command": "\x1b[31mid"}},
    )
    assert run_command("import", sent(tmp_path, *policies)).code == 0
    line = run_command("verify", "runs/small-01234567").refusal
    for words in (
        "policy b contacts ws://far:1, sends the content of the variable THEIR_TOKEN",
        "policy c reads their/folder, starts /tmp/py",
        "policy d reads /etc/weights",
        "policy f reads /data/theirs",
        "policy e gives another-package's \\x1b[31mid",
    ):
        assert words in line


@pytest.mark.parametrize("kind", catalog.kinds().values(), ids=lambda kind: kind.name)
def test_every_option_of_a_kind_is_listed_or_names_nothing_outside_of_the_suite(kind):
    numbers = {"columns", "execute", "gripper_closed", "gripper_open", "gripper_threshold", "image_size", "retries"}
    keys = {"actions", "cameras", "instruction", "proprioception", "convention", "rotation", "resize", "turn"}
    own = {"device", "identity", "recipe", "router", "sees_instruction", "token_scheme"}
    scales = {"connect_timeout_s", "joint_scale", "joints", "rotation_scale", "timeout_s", "translation_scale"}
    assert set(kind.options) <= trust.USES[kind.name].keys() | numbers | keys | own | scales


def test_a_run_of_installed_policies_needs_no_trust(run_command, tmp_path):
    merged = {"name": "m", "kind": "mergevla", "options": {"checkpoint": "zoo:absent"}}
    assert run_command("import", sent(tmp_path, "oracle", "random", merged)).code == 0
    line = run_command("verify", "runs/small-01234567", "--sample", "1").refusal
    assert "trust" not in line
    assert "policy 'oracle' has changed" in line


def test_trust_goes_past_the_list(run_command, tmp_path):
    assert run_command("import", sent(tmp_path, popen(tmp_path / "stolen"))).code == 0
    line = run_command("verify", "runs/small-01234567", "--trust").refusal
    assert "policy 'evil' has changed since the run" in line


def test_the_rows_of_an_imported_run_are_checked_without_trust(run_command, tmp_path):
    assert run_command("import", sent(tmp_path, popen(tmp_path / "stolen"))).code == 0
    done = run_command("verify", "runs/small-01234567", "--sample", "0")
    assert done.code == 0
    assert "as in run.json" in done.out


def test_a_run_of_ones_own_needs_no_trust(run_command, tmp_path):
    sent(tmp_path, popen(tmp_path / "stolen"))
    assert "has changed since the run" in run_command("verify", "theirs").refusal


def test_an_imported_run_says_so_and_repeats_no_command_of_its_author(run_command, tmp_path):
    assert run_command("import", sent(tmp_path, "oracle")).code == 0
    folder = tmp_path / "runs" / "small-01234567"
    assert read_run(folder).origin == "imported"
    write_run(folder, read_run(folder).model_copy(update={"media_left_out": 3}))
    assert run_command("report", folder).code == 0
    assert "Complete, imported" in (folder / "report.md").read_text()
    assert "touch stolen" not in (folder / "report.html").read_text()


def test_an_interpreter_in_a_document_is_listed():
    environments = {"null": {"interpreter": "/tmp/their-python"}}
    assert chosen_parts(suite(environments=environments)) == ["null starts /tmp/their-python"]
