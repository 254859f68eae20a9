"""The playing of leases, without Ray."""

import time
from dataclasses import replace

import pytest

from robogauntlet.adapters.contract import AdapterError, Delivered, TaskUnavailable
from robogauntlet.adapters.null import SIMULATOR, NullSimulation
from robogauntlet.orchestrator.episodes.episode_runner import EpisodeRunner
from robogauntlet.orchestrator.episodes.lease import Lease
from robogauntlet.orchestrator.episodes.policy_source import PolicySource, build_policy
from robogauntlet.policies.catalog import digest
from robogauntlet.policies.contract import Decision, PolicyInput, PolicyKind, PolicySpec, StatelessPolicy
from robogauntlet.results.record import is_left_out, outcome_row
from robogauntlet.suites.episode import Cell, Condition, Protocol, View


def lease(task="null/Reach", policy="oracle", seeds=(0, 1, 2), **changes):
    return Lease(Cell(policy, policy, task, Protocol(60), **changes), seeds)


@pytest.fixture
def runner():
    sources = {name: PolicySource(name) for name in ("oracle", "random", "untrained", "zero", "crooked")}
    made = EpisodeRunner(sources, "here")
    yield made
    made.close()


def test_a_lease_gives_a_row_per_episode_in_order(runner):
    results = list(runner.play(lease()))
    assert [result.seed for result in results] == [0, 1, 2]
    assert {result.status for result in results} == {"success"}
    assert {result.worker for result in results} == {"here"}


def test_only_the_first_episode_has_a_build_time(runner):
    results = list(runner.play(lease()))
    assert results[0].build_s > 0
    assert [result.build_s for result in results[1:]] == [0.0, 0.0]


def test_loading_a_policy_before_its_lease_does_not_count_as_waiting(runner, monkeypatch):
    def build_slowly(source):
        time.sleep(1.0)
        return build_policy(source)

    list(runner.play(lease()))
    monkeypatch.setattr("robogauntlet.orchestrator.episodes.episode_runner.build_policy", build_slowly)
    runner.load("zero")
    (row,) = runner.play(lease(policy="zero", seeds=(0,)))
    assert row.load_s >= 1.0
    assert row.wait_s < row.load_s


@pytest.mark.parametrize("policy", ["oracle", "random", "untrained", "zero"])
def test_rows_do_not_depend_on_the_other_episodes(runner, policy):
    together = {r.seed: outcome_row(r) for r in runner.play(lease(policy=policy, seeds=(0, 1, 2, 3)))}
    backwards = {r.seed: outcome_row(r) for r in runner.play(lease(policy=policy, seeds=(3, 2, 1, 0)))}
    alone = {seed: outcome_row(next(runner.play(lease(policy=policy, seeds=(seed,))))) for seed in range(4)}
    assert together == backwards == alone


def test_an_exception_of_a_simulator_becomes_an_error_row_and_the_next_episodes_are_played(runner):
    results = list(runner.play(lease("null/Raise", seeds=(6, 7, 8))))
    assert [result.status for result in results] == ["success", "error", "success"]
    assert results[1].error.startswith("RuntimeError: the null simulator was asked to raise [null.py:")


def test_a_simulator_that_raises_once_is_tried_again(runner, tmp_path, monkeypatch):
    monkeypatch.setenv("ROBOGAUNTLET_NULL_MARKER", str(tmp_path))
    (row,) = runner.play(lease("null/Raise", seeds=(7,)))
    assert (row.status, row.attempts) == ("success", 2)


@pytest.mark.parametrize("kind", [SystemExit, KeyboardInterrupt])
def test_a_policy_that_would_end_its_process_is_an_error_row_of_a_worker(monkeypatch, kind):
    class Leaving(StatelessPolicy):
        spec = PolicySpec(PolicyInput.NOTHING, 8)

        def act(self, queries):
            raise kind("enough")

    leaving = PolicyKind("leaving", "", lambda options: Leaving(), lambda options: "0")
    monkeypatch.setattr("robogauntlet.policies.catalog.kinds", lambda: {"leaving": leaving})
    worker = EpisodeRunner({"leaving": PolicySource("leaving")}, own_process=True)
    (row,) = worker.play(lease(policy="leaving", seeds=(0,)))
    assert row.error.startswith(f"{kind.__name__}: enough [test_episode_runner.py:")
    here = EpisodeRunner({"leaving": PolicySource("leaving")})
    with pytest.raises(kind):
        next(here.play(lease(policy="leaving", seeds=(0,))))


def test_a_policy_that_differs_from_the_plan_is_not_played():
    """Its files were changed during the run, or differ on another node."""
    planned, other = digest("zero", {}), "0" * 16
    made = EpisodeRunner({"zero": PolicySource("zero", {}, planned), "other": PolicySource("zero", {}, other)})
    (same,) = made.play(lease(policy="zero", seeds=(0,)))
    (changed,) = made.play(lease(policy="other", seeds=(0,)))
    made.close()
    assert same.error is None
    assert changed.error == (
        f"PolicyError: policy 'zero' has changed since the run was planned: expected content {other}, got {planned}"
    )


def test_an_unsupported_condition_is_an_error_row(runner):
    (unknown,) = runner.play(lease(seeds=(1,), condition=Condition("light", 3)))
    (unmovable,) = runner.play(lease(seeds=(1,), condition=Condition("camera-orbit", 3)))
    assert unknown.error.startswith("UnsupportedCondition: expected one of the axes camera-orbit, ")
    assert unmovable.error == "UnsupportedCondition: camera-orbit@3: this simulation does not let cameras be moved"


def test_a_policy_that_does_not_fit_is_an_error_row(runner, monkeypatch):
    class Crooked(StatelessPolicy):
        spec = PolicySpec(PolicyInput.NOTHING, 8, action_dim=6)

        def act(self, queries):
            return [Decision(None) for _ in queries]

    kind = PolicyKind("crooked", "", lambda options: Crooked(), lambda options: "0")
    monkeypatch.setattr("robogauntlet.policies.catalog.kinds", lambda: {"crooked": kind})
    (result,) = runner.play(lease(policy="crooked", seeds=(1,)))
    assert result.error == "PolicyMismatch: the simulation accepts 7 numbers per action, the policy produces 6"


def test_an_unknown_task_is_an_error_row_with_the_nearest_name(runner):
    (result,) = runner.play(lease("null/Raech", seeds=(1,)))
    assert result.error == "UnknownTask: unknown task 'null/Raech'; did you mean 'null/Reach'?"


def test_preparing_opens_the_task_and_names_the_render_device(runner):
    ready = runner.prepare("null/Reach", View())
    assert (ready.render_device, ready.frame_s) == ("none", None)


@pytest.fixture
def missing():
    return {"Reach"}


@pytest.fixture
def without_files(monkeypatch, missing):
    """A simulator of which some tasks lack files."""

    def opened(task, view):
        if task in missing:
            raise TaskUnavailable("it shows a scene that these assets lack")
        return SIMULATOR.open(task, view)

    lacking = replace(SIMULATOR, open=opened)
    monkeypatch.setattr("robogauntlet.adapters.catalog.find", lambda name: lacking)


def test_a_task_that_lacks_files_is_left_out_and_the_others_are_played(runner, without_files):
    assert runner.prepare("null/Reach", View()).frame_s is None
    (left_out,) = runner.play(lease(seeds=(1,)))
    (played,) = runner.play(lease("null/Raise", seeds=(1,)))
    assert left_out.error == "left out: it shows a scene that these assets lack"
    assert is_left_out(left_out.error)
    assert played.status == "success"


@pytest.mark.parametrize("missing", [{"Raise"}])
def test_the_render_device_is_known_although_the_first_task_lacks_files(runner, without_files):
    assert runner.prepare("null/Raise", View()).render_device == "none"


@pytest.mark.parametrize("error", [AdapterError("its model is broken"), KeyError("colour")])
def test_a_task_that_cannot_be_opened_affects_no_other_though_it_comes_first(runner, monkeypatch, error):
    def opened(task, view):
        if task == "Reach":
            raise error
        return SIMULATOR.open(task, view)

    monkeypatch.setattr("robogauntlet.adapters.catalog.find", lambda name: replace(SIMULATOR, open=opened))
    assert runner.prepare("null/Reach", View()).render_device == "none"
    (broken,) = runner.play(lease(seeds=(1,)))
    (played,) = runner.play(lease("null/Raise", seeds=(1,)))
    assert (broken.error.split(":")[0], played.status) == (type(error).__name__, "success")


def test_a_simulator_that_opens_no_task_is_not_ready_and_says_why_the_first_is_not_opened(runner, monkeypatch):
    def opened(task, view):
        raise AdapterError(f"no licence for {task}")

    monkeypatch.setattr("robogauntlet.adapters.catalog.find", lambda name: replace(SIMULATOR, open=opened))
    with pytest.raises(AdapterError, match="no licence for Reach"):
        runner.prepare("null/Reach", View())


def test_a_task_that_is_a_variant_says_what_it_changed(runner, monkeypatch):
    monkeypatch.setattr(NullSimulation, "delivered", lambda self: Delivered(2.5, {"x": 1.0}), raising=False)
    (row,) = runner.play(lease(seeds=(1,)))
    assert (row.delivered, row.delivered_statistics) == (2.5, '{"x": 1.0}')


def test_a_closed_runner_can_play_again(runner):
    first = outcome_row(next(runner.play(lease())))
    runner.close()
    runner.close()
    assert outcome_row(next(runner.play(lease()))) == first


def test_a_simulation_is_observed_only_after_a_reset(runner, monkeypatch):
    begun = []
    reset, observe = NullSimulation.reset, NullSimulation.observe
    monkeypatch.setattr(NullSimulation, "reset", lambda self, *start: begun.append("reset") or reset(self, *start))
    monkeypatch.setattr(NullSimulation, "observe", lambda self: begun.append("look") or observe(self))
    monkeypatch.setattr(
        "robogauntlet.orchestrator.episodes.episode_runner.simulators.find",
        lambda name: replace(SIMULATOR, renders=True),
    )
    runner.prepare("null/Reach", View())
    assert begun == ["reset", "look", "look"]
