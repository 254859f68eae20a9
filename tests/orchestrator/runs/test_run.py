"""A run folder: created, continued, refused, and always readable."""

import os
import platform
import subprocess
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from filelock import FileLock

from robogauntlet.adapters import catalog
from robogauntlet.orchestrator.environments.resolver import ONE_THREAD, EnvironmentResolver
from robogauntlet.orchestrator.runs.plan import make_plan
from robogauntlet.orchestrator.runs.run_document import create_or_continue
from robogauntlet.orchestrator.runs.suite_names import PlanError
from robogauntlet.policies import catalog as policies
from robogauntlet.policies.baselines import UntrainedPolicy
from robogauntlet.policies.contract import PolicyInput, PolicySpec
from robogauntlet.results.folder_lock import FolderError
from robogauntlet.results.run_document import RunError, RunStatus, read_run, write_run
from robogauntlet.results.store.episode_store import StoreError
from robogauntlet.results.store.run_history import History
from robogauntlet.suites.loading import SuiteError
from tests.errors import one_line_error
from tests.orchestrator.runs.playing import SUITE, Run, observer

pytestmark = [pytest.mark.ray, pytest.mark.usefixtures("ray_here")]


def test_a_run_is_not_continued_into_another_store(run, suite, tmp_path):
    plan = make_plan(suite())
    run.folder.mkdir()
    write_run(run.folder, create_or_continue(plan, run.folder, None))
    with pytest.raises(StoreError, match="there is no such file"):
        run(plan.path, store=f"sqlite:///{tmp_path / 'mistaken.sqlite'}")
    assert not (tmp_path / "mistaken.sqlite").exists()


def test_a_run_writes_its_rows_its_document_and_its_report(run, suite):
    outcome = run(suite())
    assert (outcome.document.status, outcome.done, outcome.warnings) == (RunStatus.COMPLETE, 40, [])
    assert len(run.rows()) == 40
    files = {"run.json", "report.html", "report.md", "summary.json", "episodes.parquet"}
    assert files <= {path.name for path in run.folder.iterdir()}
    assert read_run(run.folder).rows_hash == outcome.document.rows_hash


MERGING = """
merging: {expert: oracle, oracle_routed: random, routed: zero}
"""


def test_a_continued_run_may_compare_other_policies(run, suite):
    text = SUITE.replace("[oracle, random]", "[oracle, random, zero]").replace("count: 20", "count: 4")
    assert run(suite(text)).document.suite.merging is None
    outcome = run(suite(text + MERGING))
    assert outcome.document.suite.merging.routed == ("zero",)
    assert "## Merging and routing" in (run.folder / "report.md").read_text()


@pytest.mark.parametrize(
    ("lines", "name"),
    [
        (["cpu family\t: 26", "model\t\t: 2", "model name\t: AMD EPYC"], "AMD EPYC (family 26, model 2)"),
        (["BogoMIPS\t: 243.75"], platform.machine()),
    ],
)
def test_the_document_names_the_processor_with_its_family(lines, name, suite, run, tmp_path, monkeypatch):
    """Each processor has these lines; the name alone does not tell families of virtual machines."""
    (cpuinfo := tmp_path / "cpuinfo").write_text("\n".join(["processor\t: 0", *lines, "", "processor\t: 1", *lines]))
    monkeypatch.setattr("robogauntlet.orchestrator.runs.run_document.PROCESSORS", cpuinfo)
    assert create_or_continue(make_plan(suite()), run.folder, None).provenance.processor == name


def test_a_complete_run_plays_no_episode_again(finished, suite):
    before, started = read_run(finished.folder), {row.episode_id: row.started_at for row in finished.rows()}
    after = finished(suite()).document
    assert {row.episode_id: row.started_at for row in finished.rows()} == started
    assert (after.run_id, after.rows_hash) == (before.run_id, before.rows_hash)
    assert "continuing: 40 of 40 episodes already done" in finished.output.getvalue()


def test_an_interrupted_run_is_readable_and_is_continued(run, suite, tmp_path):
    path = suite(SUITE.replace("Reach", "Slow").replace("count: 20", "count: 10"))
    undisturbed = Run(tmp_path / "undisturbed")
    undisturbed(path)

    def interrupt(rows):
        raise KeyboardInterrupt

    outcome = run(path, observers=[observer(on_rows=interrupt)])
    assert outcome.document.status is RunStatus.INTERRUPTED
    assert 0 < outcome.done < 20
    assert "interrupted" in (run.folder / "report.md").read_text()
    outcome = run(path)
    assert (outcome.document.status, outcome.done) == (RunStatus.COMPLETE, 20)
    assert outcome.document.rows_hash == read_run(undisturbed.folder).rows_hash


@pytest.mark.nightly
def test_the_elapsed_time_of_a_killed_session_is_kept(run, suite, monkeypatch):
    class Killed(BaseException):
        """Not caught by the run, which therefore cannot finish."""

    def die(run):
        time.sleep(0.2)
        if run.progress.simulators()[0].done > 3:
            raise Killed

    path = suite(SUITE.replace("Reach", "Slow"))
    monkeypatch.setattr("robogauntlet.orchestrator.runs.run.SAVE_ELAPSED_S", 0.1)
    with pytest.raises(Killed):
        run(path, observers=[observer(on_tick=die)])
    taken = read_run(run.folder).elapsed_s
    assert taken > 0.2
    assert run(path).document.elapsed_s > taken


def test_a_folder_of_another_suite_is_refused_and_unchanged(finished, suite):
    before = (finished.folder / "run.json").read_text()
    with pytest.raises(PlanError, match="holds a run of suite 'nulls', not 'others'; give another folder with --out"):
        finished(suite(SUITE.replace("name: nulls", "name: others").replace("count: 20", "count: 5")))
    with pytest.raises(PlanError, match="suite 'nulls' plans other episodes than when the run was begun"):
        finished(suite(SUITE.replace("count: 20", "count: 21")))
    assert (finished.folder / "run.json").read_text() == before


def test_a_changed_policy_does_not_continue_an_old_run(finished, suite, monkeypatch):
    digest = policies.digest
    monkeypatch.setattr("robogauntlet.policies.catalog.digest", lambda kind, options: digest(kind, options)[::-1])
    with pytest.raises(PlanError, match="policy 'oracle' has changed since the run was begun"):
        finished(suite())


def test_a_continued_run_may_have_other_run_settings(finished, suite):
    assert finished(suite(SUITE.replace("workers: 1", "workers: 2"))).document.status is RunStatus.COMPLETE


def test_two_names_for_one_policy_are_refused(suite):
    path = suite(SUITE.replace("[oracle, random]", "[oracle, {name: other, kind: oracle}]"))
    with pytest.raises(SuiteError, match="policies 'oracle' and 'other' are the same policy; remove one"):
        make_plan(path)


@pytest.mark.parametrize(
    ("spec", "keys", "message"),
    [
        ({"action_dim": 6}, {}, "the simulation accepts 7 numbers per action, the policy produces 6"),
        ({"image_size": 224}, {"image_size": 96}, "made for 224 px images, the suite renders 96 px"),
        ({"image_size": 224}, {"cameras": "[third_person]"}, "needs camera wrist, the suite renders third_person"),
    ],
    ids=["actions", "image size", "camera"],
)
def test_a_policy_that_does_not_fit_is_refused_before_anything_starts(suite, monkeypatch, spec, keys, message):
    spec = PolicySpec(PolicyInput.OBSERVATION, 8, cameras=("wrist",), **spec)
    monkeypatch.setattr(UntrainedPolicy, "spec", spec)
    with pytest.raises(SuiteError, match=message):
        make_plan(suite(SUITE.replace("[oracle, random]", "[untrained]"), **keys))


def test_a_policy_of_one_arm_is_refused_in_a_task_of_two_before_anything_starts(suite):
    tasks = "[null/Reach, robosuite/TwoArmLift@TwoPandas]"
    text = SUITE.replace("[oracle, random]", "[replay]")
    with pytest.raises(SuiteError, match="TwoPandas accepts 14 numbers per action, the policy produces 7"):
        make_plan(suite(text.replace("[null/Reach]", tasks)))
    with pytest.raises(SuiteError, match="the simulation accepts 14 numbers per action, the policy produces 7"):
        make_plan(suite(text.replace("[null/Reach]", "[robosuite/TwoArmLift@TwoPandas]")))


def test_a_simulator_that_is_not_installed_is_skipped_and_named(run, suite, monkeypatch):
    lift = catalog.find("robosuite")
    known = {**catalog.simulators(), "robosuite": replace(lift, modules=("no_such_module",))}
    monkeypatch.setattr("robogauntlet.adapters.catalog.simulators", lambda: known)
    path = suite(SUITE.replace("[null/Reach]", "[null/Reach, robosuite/Lift]"))
    outcome = run(path)
    reason = 'not installed (no module no_such_module); install it: pip install "robogauntlet[robosuite]"'
    assert outcome.document.skipped == {"robosuite": reason}
    assert (outcome.done, outcome.document.status) == (40, RunStatus.COMPLETE)
    assert "not installed (no module" in (run.folder / "report.md").read_text()
    with pytest.raises(PlanError, match="robosuite: not installed"):
        make_plan(path, only=["robosuite"])


def test_too_many_errors_stop_the_run_and_keep_its_rows(run, suite):
    outcome = run(suite(SUITE.replace("null/Reach", "null/Raise"), error_tolerance=0.0))
    assert outcome.document.status is RunStatus.STOPPED
    assert "the suite tolerates 0" in outcome.document.reason
    assert 0 < outcome.done < 40


def test_a_run_of_which_nothing_was_played_is_stopped_and_says_why(run, suite, monkeypatch):
    def skip(session, work):
        session._observers.on_skipped("null", "it cannot render\nhere", sum(len(seeds) for _, seeds in work))

    monkeypatch.setattr("robogauntlet.orchestrator.runs.run.RunSession._play", skip)
    outcome = run(suite())
    assert (outcome.done, outcome.document.status) == (0, RunStatus.STOPPED)
    assert outcome.document.reason == "no episode was played; null is skipped: it cannot render"


def test_ray_has_the_variables_that_all_simulators_of_a_run_share_whatever_is_left_to_play(run, suite, monkeypatch):
    asked, of_null = [], lambda run: [(cell, (0,)) for cell in run._plan.cells if cell.simulator == "null"]
    monkeypatch.setattr(EnvironmentResolver, "shared_variables", lambda _, names: asked.append({*names}))
    monkeypatch.setattr("robogauntlet.orchestrator.runs.run.RunSession._remaining_work", of_null)
    run(suite(SUITE.replace("/Reach", "/Reach, pybullet/PandaReach-v3")))
    assert asked == [{"null", "pybullet"}]


def test_errors_are_kept_until_a_retry_is_requested(run, suite, tmp_path, monkeypatch):
    path = suite(SUITE.replace("null/Reach", "null/Raise"), error_tolerance=1.0)
    run(path)
    errors = [row for row in run.rows() if row.status == "error"]
    assert {row.seed for row in errors} == {0, 7, 14}
    monkeypatch.setitem(ONE_THREAD, "ROBOGAUNTLET_NULL_MARKER", str(tmp_path))
    run(path)
    assert len([row for row in run.rows() if row.status == "error"]) == len(errors)
    outcome = run(path, retry_errors=True)
    assert outcome.done == 40
    assert not [row for row in run.rows() if row.status == "error"]


@pytest.mark.parametrize("content", [b"this is no database at all, only text", b"\0" * 5000])
def test_an_invalid_store_is_refused_and_unchanged(run, suite, content):
    run.folder.mkdir()
    (run.folder / "episodes.sqlite").write_bytes(content)
    with pytest.raises(StoreError, match=r"episodes\.sqlite: expected a store, this file is something else"):
        run(suite())
    assert (run.folder / "episodes.sqlite").read_bytes() == content
    assert not (run.folder / "run.json").exists()


def test_a_run_document_that_is_broken_is_refused(finished, suite):
    (finished.folder / "run.json").write_text('{"format": 1}')
    with pytest.raises(RunError, match=r"run\.json: expected a run document of format 1"):
        finished(suite())


def test_rows_that_cannot_be_read_at_the_end_are_not_counted_as_none(finished, suite, monkeypatch):
    answers = [{}]  # at the beginning

    def counts(history, run_id):
        if not answers:
            raise StoreError("db: server closed the connection")
        return answers.pop()

    monkeypatch.setattr(History, "count_cells", counts)
    outcome = finished(suite())
    assert (outcome.document.status, outcome.done) == (RunStatus.STOPPED, None)
    assert outcome.document.reason == "db: server closed the connection"


def test_a_complete_run_without_a_report_is_stopped(finished, suite):
    (finished.folder / "report.html").unlink()
    (finished.folder / "report.html").mkdir()
    outcome = finished(suite())
    assert outcome.report is None
    assert outcome.document.status is RunStatus.STOPPED
    assert "the report could not be written: " in outcome.document.reason
    (finished.folder / "report.html").rmdir()
    assert finished(suite()).document.status is RunStatus.COMPLETE


def test_a_file_in_place_of_the_folder_is_refused(tmp_path, suite):
    (tmp_path / "run").write_text("I am a file")
    with pytest.raises(FolderError, match="expected a folder, this is a file"):
        Run(tmp_path / "run")(suite())


def test_a_folder_that_cannot_be_written_is_refused(suite):
    with pytest.raises(FolderError, match="/proc/self/fdinfo/run: "):
        Run(Path("/proc/self/fdinfo/run"))(suite())


def test_two_processes_do_not_write_into_one_folder(run, suite):
    run.folder.mkdir()
    with FileLock(run.folder / ".lock"), pytest.raises(FolderError, match="another process runs into this folder"):
        run(suite())


@pytest.fixture
def tiny_disk(tmp_path):
    """A file system of 300 KiB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=300k", "tmpfs", str(folder)]
    if os.geteuid() != 0 or subprocess.run(command, capture_output=True, check=False).returncode:
        pytest.skip("this machine lets nobody mount a small file system")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


def test_a_full_disk_stops_the_run_which_can_be_continued(tiny_disk, suite, tmp_path):
    path = suite(SUITE.replace("count: 20", "count: 300"))
    run = Run(tiny_disk / "run")
    outcome = run(path)
    assert outcome.document.status is RunStatus.STOPPED
    assert "full" in outcome.document.reason
    assert 0 < outcome.done < 600
    subprocess.run(["mount", "-o", "remount,size=100m", str(tiny_disk)], check=True)
    outcome = run(path)
    assert (outcome.document.status, outcome.done) == (RunStatus.COMPLETE, 600)


def test_the_place_of_inference_is_chosen_shown_and_recorded(run, suite):
    text = SUITE.replace("[oracle, random]", "[untrained]").replace("count: 20", "count: 4")
    served = run(suite(text, inference="served"))
    assert served.document.inference == "served"
    assert "in separate inference processes" in (run.folder / "report.md").read_text()
    run.folder = run.folder.parent / "auto"
    chosen = run(suite(text, inference="auto")).document.inference
    assert chosen in ("worker", "served")
    assert "measuring where policies answer faster" in run.output.getvalue()
    words = {"worker": "in the workers: ", "served": "in separate inference processes: "}[chosen]
    assert f"policies compute {words}" in run.output.getvalue()
    assert served.document.rows_hash == read_run(run.folder).rows_hash


@pytest.mark.parametrize(
    ("asked", "key"),
    [
        ({"resources": "{'null': {num_gpus: 60}}"}, "resources.null.num_gpus"),
        ({"inference": "{place: served, num_gpus: 60}"}, "inference.num_gpus"),
    ],
)
def test_unavailable_resources_stop_the_run_before_the_first_episode(run, suite, asked, key):
    outcome = run(suite(**asked))
    assert (outcome.document.status, outcome.done) == (RunStatus.STOPPED, 0)
    assert outcome.document.reason.startswith(f"{key}: expected at most what one node has, ")


@pytest.mark.parametrize("moment", [-1.0, 9e9])
def test_a_clock_of_another_century_is_one_line(run, suite, monkeypatch, moment):
    clock = SimpleNamespace(time=lambda: moment, monotonic=time.monotonic)
    monkeypatch.setattr("robogauntlet.orchestrator.runs.run_document.time", clock)
    with one_line_error(PlanError, "this machine's clock is before 1970 or after 2200; set it"):
        run(suite())
    assert not (run.folder / "run.json").exists()


def test_a_clock_that_is_set_back_does_not_shorten_a_run(run, suite, monkeypatch):
    moments = iter(range(2_000_000_000, 0, -86_400))
    clock = SimpleNamespace(time=lambda: float(next(moments)), monotonic=time.monotonic)
    monkeypatch.setattr("robogauntlet.orchestrator.runs.run.time", clock)
    assert 0 < run(suite()).document.elapsed_s < 600


def test_shared_workers_are_counted_separately(run, suite):
    document = run(suite(SUITE.replace("workers: 1", "workers: auto").replace("count: 20", "count: 2"))).document
    assert document.workers == {}
    assert document.shared_workers >= 1
