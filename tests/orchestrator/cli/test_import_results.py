"""`robogauntlet import` of result files of others."""

import os

import pytest

from tests import ROOT

DATA = ROOT / "tests" / "data" / "results_of_others"


def test_a_table_of_trials_is_reported_listed_and_compared_and_never_played(run_command):
    done = run_command("import", DATA / "trials.csv", "--out", "runs/towels")
    assert done.code == 0, done.err
    assert "columns ignored: operator" in done.out
    assert "8 planned episodes of trials" in done.out
    assert "not paired: 4 and 4 trials" in run_command("compare", "runs/towels").out
    assert "not paired: 4 and 4 trials" in run_command("compare", "runs/towels:act", "runs/towels:dp").out
    assert '"unpaired"' in run_command("compare", "runs/towels", "--format", "json").out
    assert run_command("compare", "runs/towels", "--out", "c.md", "--format", "markdown").code == 0
    assert run_command("compare", "runs/towels", "--out", "c.md", "--format", "text").code == 0  # replaces its own kind
    assert "fold towel" in run_command("report", "runs/towels").out
    assert "complete, imported" in run_command("list", "runs").out
    assert "or Fisher on separate trials" in run_command("compare", "--all", "trials", "--imported").out
    for typed in ("resume runs/towels", "replay --verify runs/towels", "compare --accept towels"):
        run_command(*typed.split()).refusal  # noqa: B018
    assert "is not a baseline" in run_command("compare", "--gate", "runs/towels", "runs/towels").refusal


def test_files_of_lerobot_are_a_run_with_a_policy_each(run_command):
    file = DATA / "eval_info_one_task.json"
    done = run_command(
        *("import", file, file, "--policy", "act", "--policy", "dp", "--task", "pusht/pusht", "--name", "pusht"),
        *("--out", "runs/pusht"),
    )
    assert done.code == 0, done.err
    assert "6 planned episodes of pusht in" in done.out
    assert "act against dp: +0.0 [" in run_command("compare", "runs/pusht").out


def test_a_file_of_vla_eval_has_errors(run_command):
    done = run_command("import", DATA / "libero_aggregate.json", "--policy", "pi0", "--out", "runs/libero")
    assert "1 error of pi0, which vla-eval counts as failures" in done.out
    assert "server_disconnected" in (ROOT / done.out.split("report: ")[1].strip()).read_text()


def test_the_same_trials_are_imported_once(run_command):
    assert run_command("import", DATA / "trials.csv").code == 0
    assert "is in the history already" in run_command("import", DATA / "trials.csv").refusal


def test_a_simulated_run_and_a_real_one_are_compared_on_separate_trials(run_command, tmp_path):
    for name, task, won in (("sim", "pybullet/Reach", (9, 5, 1)), ("real", "reach", (4, 7, 1))):
        lines = [
            f"{policy},{task},{n},{int(n < own)}" for policy, own in zip("abc", won, strict=True) for n in range(10)
        ]
        (tmp_path / f"{name}.csv").write_text("\n".join(["policy,task,trial,success", *lines]))
        assert run_command("import", f"{name}.csv", "--out", f"runs/{name}").code == 0
    typed = ("compare", "runs/sim", "runs/real", "--task", "pybullet/Reach=reach")
    done = run_command(*typed)
    assert (done.code, done.err) == (0, "")
    assert "separate trials, not paired: sim against real\n- a: +50.0 [" in done.out
    assert "90 % [60, 98]  40 % [17, 69]" in done.out
    assert "- sim predicts real, by 3 policies in 1 task: Pearson's r 0.50, Kendall's tau 0.33 [" in done.out
    for form in ("json", "markdown", "text", "json"):  # each replaces the other
        assert run_command(*typed, "--format", form, "--out", "found").code == 0
    apart = run_command("compare", "runs/sim", "runs/real", "--format", "json", "--out", "found")
    assert apart.code == 2
    assert '"agreement": null' in (tmp_path / "found").read_text()
    refused = run_command("compare", "--gate", "runs/sim").refusal
    said = "--gate: expected a run that was played, runs/sim has results of others; compare it without --gate"
    assert refused == said


@pytest.mark.parametrize(
    ("typed", "message"),
    [
        ("compare runs/sim runs/real --task reach", "--task: expected TASK=OTHER, got 'reach'"),
        ("compare runs/sim runs/real --task =reach", "--task: expected TASK=OTHER, got '=reach'"),
        ("compare runs/sim runs/real --task a/b=c --task a/b=d", "--task: expected each task once, got 'a/b=d'"),
        ("compare runs/sim:a runs/real:a --task a/b=c", "--task: expected with two whole runs, RUN OTHER"),
        ("compare runs/sim --task a/b=c", "--task: expected with two whole runs, RUN OTHER"),
        ("compare --gate runs/sim runs/real --task a/b=c", "--task: expected without --gate"),
    ],
)
def test_options_that_do_not_fit_are_refused(run_command, typed, message):
    assert message in run_command(*typed.split()).refusal


@pytest.mark.parametrize(
    ("typed", "message"),
    [
        ("trials.csv trials.csv --policy a", "expected one --policy for each of 2 files, got 1"),
        ("trials.csv trials.csv", "trials.csv: expected each trial once, trial 1 of act in trials/fold towel"),
        ("trials.csv --name ?", "--name: expected a name with a letter or digit, got '?'"),
        ("trials.csv run.zip", "expected one exported run, or result files of others, got 2 files"),
        ("run.zip --name x", "--name: expected with result files of others, not with an exported run"),
        ("run.zip --paired", "--paired: expected with result files of others, not with an exported run"),
        ("pipe.csv", "pipe.csv: expected a file of results, got a named pipe, no regular file"),
        ("folder.csv", "folder.csv: expected a file of results, got a folder, no regular file"),
        ("none.json", "none.json: cannot be read: No such file or directory"),
    ],
)
def test_bad_input_is_refused_in_one_line_and_leaves_nothing(run_command, tmp_path, typed, message):
    os.mkfifo(tmp_path / "pipe.csv")
    (tmp_path / "folder.csv").mkdir()
    (tmp_path / "trials.csv").write_bytes((DATA / "trials.csv").read_bytes())
    before = sorted(tmp_path.rglob("*"))
    assert message in run_command("import", *typed.split()).refusal
    assert [path for path in sorted(tmp_path.rglob("*")) if path not in before and path.name != "runs"] == []
