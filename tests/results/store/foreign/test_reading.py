"""Result files of others are read as they are meant, and what is none is refused in one line."""

import json
import os
from contextlib import suppress

import pytest
from hypothesis import given, strategies as st

from robogauntlet.results.run_document import RunError
from robogauntlet.results.store.foreign import trials
from robogauntlet.results.store.foreign.csv_table import read_csv
from robogauntlet.results.store.foreign.files import read_files
from robogauntlet.results.store.foreign.json_file import read_json
from robogauntlet.results.store.foreign.trials import BadResults
from tests import ROOT
from tests.errors import one_line_error

DATA = ROOT / "tests" / "data" / "results_of_others"


def outcomes(results):
    return [(trial.task, trial.label, trial.success) for trial in results.trials]


def test_a_table_of_trials():
    found = read_files([DATA / "trials.csv"])
    assert outcomes(found)[:4] == [
        ("trials/fold towel", "1", True),
        ("trials/fold towel", "2", False),
        ("trials/fold towel", "3", True),
        ("robot/pick cup", "1", True),
    ]
    assert {trial.policy for trial in found.trials} == {"act", "dp"}
    assert not found.paired
    assert found.notes == ("columns ignored: operator",)


@pytest.mark.parametrize(("column", "paired"), [("trial", False), ("seed", True), ("state", True), ("State ", True)])
def test_a_column_of_states_pairs_the_trials(column, paired):
    assert read_csv(f"\ufeffPolicy,task,{column},success\n\na,b,7.0,TRUE\n".encode()).paired == paired


def test_an_evaluation_of_one_task_with_lerobot():
    found = read_files([DATA / "eval_info_one_task.json"], ["act"], task="pusht")
    assert outcomes(found) == [
        ("trials/pusht", "1000", True),
        ("trials/pusht", "1001", False),
        ("trials/pusht", "1002", True),
    ]
    assert found.paired


def test_an_evaluation_without_seeds_is_not_paired():
    content = json.loads((DATA / "eval_info_one_task.json").read_text())
    content["per_episode"][1]["seed"] = None
    found = read_json(json.dumps(content).encode(), "act", "a/b")
    assert [label for _, label, _ in outcomes(found)] == ["0", "1", "2"]
    assert not found.paired


def test_an_evaluation_of_several_tasks_with_lerobot():
    found = read_files([DATA / "eval_info.json"], ["act"])
    assert outcomes(found) == [
        ("libero_spatial/0", "0", True),
        ("libero_spatial/0", "1", False),
        ("libero_spatial/0", "2", True),
        ("libero_object/3", "0", False),
        ("libero_object/3", "1", False),
    ]
    assert not found.paired


def test_an_evaluation_with_vla_eval_has_errors_and_tells_tasks_of_one_name_apart():
    found = read_files([DATA / "libero_aggregate.json"], ["pi0"])
    simulator = "LIBEROBenchmark_libero_spatial"
    assert outcomes(found) == [
        (f"{simulator}/open the drawer (0)", "0", True),
        (f"{simulator}/open the drawer (0)", "1", False),
        (f"{simulator}/open the drawer (7)", "0", True),
        (f"{simulator}/pick up the bowl", "0", None),
    ]
    assert found.trials[-1].error == "server_disconnected: ConnectionClosed: 1006"
    assert found.notes == ("1 error of pi0, which vla-eval counts as failures",)


def test_one_file_per_policy():
    found = read_files([DATA / "eval_info.json"] * 2, ["act", "dp"], paired=True)
    assert [trial.policy for trial in found.trials] == 5 * ["act"] + 5 * ["dp"]
    assert found.paired


HEAD = "policy,task,trial,success\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "expected a column policy or --policy NAME, got none"),
        ("\n", "expected a column policy or --policy NAME, got none"),
        (HEAD, "it has none"),
        ("policy;task;trial;success\n", "expected a column policy or --policy NAME, got policy;task;trial;success"),
        ("policy,task,trial\na,b,1\n", "expected a column success, got policy, task, trial"),
        ("policy,task,success\na,b,1\n", "expected one column of trial, seed or state, got policy, task, success; num"),
        ("policy,task,trial,seed,success\na,b,1,1,1\n", "expected one column of trial, seed or state, got"),
        ("policy,task,trial,success,task\na,b,1,1,c\n", "expected one column task, got 2"),
        (HEAD + "a,b,1\n", "line 2: expected 4 values, got 3"),
        (HEAD + "a,b,1,1\na,b,2,maybe\n", "line 3: expected success as true or false .*, got 'maybe'"),
        (HEAD + "a,b,1,\n", "line 2: expected success as true or false .*, got nothing"),
        (HEAD + "a,b,1,0.5\n", "got '0.5'"),
        (HEAD + "a,b,1,nan\n", "got 'nan'"),
        (HEAD + "a,b,NaN,1\n", "line 2: expected a trial of at most 300 printable characters, got 'NaN'"),
        (HEAD + ",b,1,1\n", "line 2: expected a policy .*, got nothing"),
        (HEAD + "a,b\x1b[2J,1,1\n", "line 2: expected a task"),
        (HEAD + f"a,{'b' * 301},1,1\n", "line 2: expected a task"),
        (HEAD + 'a,"b,1,1\n', "line 2: expected CSV, unexpected end of data"),
        (HEAD + f"a,{'b' * 200_000},1,1\n", "line 2: expected CSV, field larger"),
        (b"\x89PNG\xff\x00", "in UTF-8, this is something else"),
    ],
)
def test_a_table_that_is_none_is_refused(text, message):
    with one_line_error(BadResults, message):
        read_csv(text if isinstance(text, bytes) else text.encode())


def one_task(**changes):
    return {"per_episode": [{"episode_ix": 0, "success": True, "seed": 3, **changes}]}


def vla(**changes):
    episode = {"episode_id": 0, "metrics": {"success": True}, **changes}
    return {"benchmark": "B", "tasks": [{"task": "t", "episodes": [episode]}]}


def several(*successes, **changes):
    return {"task_group": "g", "task_id": 0, "metrics": {"successes": list(successes)}, **changes}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({}, "this is something else, with no keys"),
        ([], "this is something else, with no keys"),
        (None, "this is something else"),
        ({"overall": {}, "results": []}, "this is something else, with overall, results"),
        ({"per_episode": []}, "expected results with a trial, it has none"),
        ({"per_episode": {}}, r"per_episode: expected a list, got {}"),
        ({"per_episode": [7]}, r"per_episode\[0\]: expected an object, got 7"),
        (one_task(success=None), r"per_episode\[0\]: expected success .*, got nothing"),
        (one_task(success=float("nan")), "expected success .*, got nan"),
        (one_task(success=2), "expected success .*, got 2"),
        (one_task(success=[True]), "expected success"),
        (one_task(seed=float("nan")), "expected a trial .*, got nan"),
        (one_task(seed=True), "expected a trial .*, got True"),
        (one_task(seed={"a": 1}), "expected a trial"),
        ({"per_task": []}, "it has none"),
        ({"per_task": [several(True), several(True)]}, r"per_task\[1\]: expected each task once, g/0 is there twice"),
        ({"per_task": [several(True, metrics=None)]}, r"per_task\[0\].metrics: expected an object, got nothing"),
        ({"per_task": [several("perhaps")]}, r"successes\[0\]: expected success .*, got 'perhaps'"),
        ({"per_task": [several(True, task_group="\ud800")]}, "expected a task_group"),
        (vla(metrics={}), r"tasks\[0\].episodes\[0\].metrics: expected success .*, got nothing"),
        (vla(metrics=[]), r"metrics: expected an object"),
        (vla(episode_id=None), "expected a trial .*, got nothing"),
        ({"benchmark": "B", "tasks": [{"task": "t"}]}, r"tasks\[0\].episodes: expected a list, got nothing"),
        ({"benchmark": None, "tasks": []}, "the file: expected a benchmark"),
    ],
)
def test_a_json_file_of_another_form_is_refused(content, message):
    task = "t" if isinstance(content, dict) and "per_episode" in content else None
    with one_line_error(BadResults, message):
        read_json(json.dumps(content).encode(), "p", task)


@pytest.mark.parametrize("text", [b"", b"{", b"[" * 100_000, b"\xff\xfe", b'{"per_episode": [' + b"9" * 5_000 + b"]}"])
def test_damaged_json_is_refused(text):
    with one_line_error(BadResults, "this is no JSON, or damaged"):
        read_json(text, "p")


@pytest.mark.parametrize("name", sorted(path.name for path in DATA.iterdir()))
@given(data=st.data())
def test_a_file_that_was_cut_off_is_read_or_refused(name, data):
    content = (DATA / name).read_bytes()
    end = data.draw(st.integers(0, len(content) - 3))
    if name.endswith(".csv"):
        with suppress(BadResults):
            read_csv(content[:end])
    else:
        with one_line_error(BadResults):
            read_json(content[:end], "p")


def folder(path):
    path.mkdir()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (folder, "got a folder, no regular file"),
        (os.mkfifo, "got a named pipe, no regular file"),
        (lambda path: path.symlink_to("/dev/zero"), "got a device, no regular file"),
        (lambda path: None, "cannot be read: No such file"),
        (lambda path: path.open("wb").truncate(trials.LARGEST_FILE + 1), "got more than 67,108,864 bytes"),
    ],
)
@pytest.mark.parametrize("name", ["a.csv", "a.JSON"])
def test_what_is_no_file_of_moderate_size_is_refused(tmp_path, make, message, name):
    make(tmp_path / name)
    with one_line_error(RunError, message):
        read_files([tmp_path / name], ["p"])


def test_the_number_of_trials_is_bounded(monkeypatch, tmp_path):
    for module in ("trials", "csv_table"):
        monkeypatch.setattr(f"robogauntlet.results.store.foreign.{module}.MOST_TRIALS", 3)
    with one_line_error(BadResults, "expected at most 3 trials, got more"):
        read_csv((HEAD + "".join(f"a,b,{n},1\n" for n in range(4))).encode())
    with one_line_error(BadResults, "expected at most 3 trials, got more"):
        read_json(json.dumps({"per_task": [several(*4 * [True])]}).encode(), "p")
    for name in ("a.csv", "b.csv"):
        (tmp_path / name).write_text(HEAD + "a,b,1,1\na,b,2,1\n")
    with one_line_error(RunError, "expected at most 3 trials, got more"):
        read_files([tmp_path / "a.csv", tmp_path / "b.csv"])


ONE, SEVERAL, TABLE = DATA / "eval_info_one_task.json", DATA / "eval_info.json", DATA / "trials.csv"


@pytest.mark.parametrize(
    ("files", "options", "message"),
    [
        ([SEVERAL], {}, "expected --policy NAME, since the file does not name the policy"),
        ([ONE], {"policies": ["p"]}, "expected --task NAME, since the file does not name its task"),
        ([ONE], {"policies": ["p"], "task": ""}, "--task: expected a task"),
        ([SEVERAL], {"policies": ["p"], "task": "t"}, "expected no --task, the file names its tasks"),
        ([TABLE], {"task": "t"}, "expected no --task, the table has a column task"),
        ([TABLE], {"policies": ["p"]}, "expected no --policy, the table has a column policy"),
        ([SEVERAL, SEVERAL], {"policies": ["p"]}, "expected one --policy for each of 2 files, got 1"),
        ([SEVERAL, DATA / "libero_aggregate.json"], {"policies": ["p", "q"]}, "got lerobot-eval and vla-eval"),
    ],
)
def test_files_that_do_not_go_with_the_options_are_refused(files, options, message):
    with one_line_error(RunError, message):
        read_files(files, **options)
