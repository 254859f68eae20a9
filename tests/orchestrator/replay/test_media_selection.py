"""The episodes that get a video, and the conditions that get a snapshot."""

from itertools import product

from robogauntlet.orchestrator.replay.media import episodes_to_film, pending_media
from robogauntlet.orchestrator.replay.media_selection import (
    Snapshot,
    condition_snapshots,
    new_failures,
    recording_order,
    representative_episodes,
)
from robogauntlet.results.media_paths import video_path
from robogauntlet.suites.episode import Condition, View
from tests.results.synthetic import cells, row

CLEAN, BLUR2, BLUR4, NOISE = Condition(), Condition("blur", 2), Condition("blur", 4), Condition("noise", 2)
PUSH, LIFT = "maniskill/PushCube-v1", "robosuite/Lift"
ALL = (CLEAN, BLUR2, BLUR4, NOISE)


def cell(task=PUSH, condition=CLEAN, policy="experts"):
    return next(iter(cells((policy,), (task,), (condition,))))


def chosen(rows, policies=("experts",)):
    return [(r.task, r.axis, r.severity, r.seed) for r in new_failures(lambda: iter(rows), policies)]


def test_representative_episodes_are_clean_if_possible_and_of_the_first_seed():
    rows = [
        row(cell(condition=BLUR2), 0, "failure"),
        row(cell(), 3),
        row(cell(), 1),
        row(cell(condition=BLUR2), 0),
        row(cell(), 0, "error"),
    ]
    assert [(r.status, r.axis, r.seed) for r in representative_episodes(rows)] == [
        ("failure", "blur", 0),
        ("success", "clean", 1),
    ]


def test_a_new_failure_succeeded_in_the_clean_condition():
    rows = [row(cell(), 0, "failure"), row(cell(), 1), *(row(cell(condition=BLUR2), s, "failure") for s in (0, 1))]
    assert chosen(rows) == [(PUSH, "blur", 2, 1)]


def test_the_new_failure_of_lowest_severity_then_seed_is_chosen():
    rows = [row(cell(), seed) for seed in range(4)]
    rows += [row(cell(condition=BLUR4), 0, "failure"), *(row(cell(condition=BLUR2), s, "failure") for s in (3, 2))]
    assert chosen(rows) == [(PUSH, "blur", 2, 2)]


def test_each_axis_simulator_and_policy_has_its_own_new_failure():
    clean = [row(cell(task, policy=p), 0) for task in (PUSH, LIFT) for p in ("experts", "merged", "oracle")]
    falls = [
        row(cell(task, condition, p), 0, "failure")
        for task in (PUSH, LIFT)
        for condition in (BLUR2, NOISE)
        for p in ("experts", "merged", "oracle")
    ]
    found = new_failures(lambda: [*clean, *falls], ("experts", "merged"))
    expected = {*product(("experts", "merged"), ("blur", "noise"), ("maniskill", "robosuite"))}
    assert {(r.policy, r.axis, r.simulator) for r in found} == expected


def test_controls_and_errors_are_no_new_failures():
    rows = [row(cell(), 0), row(cell(condition=Condition("blind", 1)), 0, "failure")]
    assert chosen([*rows, row(cell(condition=BLUR2), 0, "error")]) == []


PULL = "maniskill/PullCube-v1"


def played(policy, status="success", *, task=PUSH, seed=0, acts="same"):
    return row(cell(task, policy=policy), seed, status, actions_hash=acts)


def test_policies_that_acted_identically_share_a_video(tmp_path):
    rows = [played(name) for name in ("a", "b", "c")] + [played("d", acts="else"), played("e", seed=1)]
    recorded = [(r.policy, r.seed) for r in recording_order(representative_episodes(rows))]
    assert sorted(recorded) == [("a", 0), ("d", 0), ("e", 1)]
    assert len(pending_media(tmp_path, lambda: rows, (), [])[1]) == 3
    file = video_path(tmp_path, rows[1].episode_id)
    file.parent.mkdir(parents=True)
    file.touch()
    assert {r.policy for r in pending_media(tmp_path, lambda: rows, (), [])[1]} == {"d", "e"}


def test_tasks_and_outcomes_take_turns_and_videos_of_many_policies_come_first():
    rows = [
        *(played(name, task=PULL) for name in ("b", "c")),
        played("a", task=PULL, acts="else"),
        played("d", "failure", task=PULL, acts="failing"),
        *(played(name, acts=name) for name in ("a", "b")),
        played("c", "failure", acts="failing"),
    ]
    assert [(r.task, r.policy) for r in recording_order(rows)] == [
        *((PULL, "b"), (PUSH, "a")),
        *((PUSH, "c"), (PULL, "d")),
        *((PULL, "a"), (PUSH, "b")),
    ]


def test_a_failure_of_each_policy_comes_before_snapshots_and_all_other_videos(tmp_path):
    rows = [played("a"), played("b"), played("b", "failure", seed=3, acts="b"), played("random", "failure", acts="r")]
    rows += [played("a", "failure", task=PULL, seed=2, acts="a"), played("a", "failure", task=PULL, seed=1, acts="aa")]
    snapshot = Snapshot(PUSH, CLEAN, 0, View())
    first, (second, *others) = pending_media(tmp_path, lambda: rows, ("a", "b"), [snapshot])
    assert [(item.policy, item.seed) for item in first] == [("a", 1), ("b", 3)]
    assert second == snapshot
    assert [(item.policy, item.status) for item in others] == [("a", "success"), ("random", "failure")]
    assert pending_media(tmp_path, lambda: rows, (), [])[0][2].policy == "random"


def test_a_clean_episode_is_filmed_if_there_is_one_the_second_of_its_cell():
    noisy, clean = cells(("experts",), (PUSH,), (NOISE, CLEAN))
    assert episodes_to_film([(noisy, (0, 1)), (clean, (4, 5, 6))]) == {clean.episode(5).id}


def test_no_other_failure_of_a_policy_comes_first_where_one_has_a_video(tmp_path):
    rows = [played("a", "failure", task=PULL), played("a", "failure", seed=1)]
    video_path(tmp_path, rows[1].episode_id).parent.mkdir(parents=True)
    video_path(tmp_path, rows[1].episode_id).touch()
    assert pending_media(tmp_path, lambda: rows, ("a",), []) == ([], [rows[0]])


def test_snapshots_have_every_severity_on_each_simulators_first_task():
    tasks = (PUSH, "maniskill/PullCube-v1", LIFT)
    plan = cells(("oracle", "experts"), tasks, (CLEAN, BLUR2, BLUR4, Condition("blind", 1)))
    snapshots = condition_snapshots(plan, 7)
    assert snapshots == [
        Snapshot(task, condition, 7, View()) for task in (PUSH, LIFT) for condition in (CLEAN, BLUR2, BLUR4)
    ]


def test_snapshots_show_the_first_task_with_the_axis():
    plan = [*cells(("oracle",), (PUSH,), (CLEAN,)), *cells(("oracle",), ("maniskill/PullCube-v1",), (CLEAN, NOISE))]
    assert {snapshot.task for snapshot in condition_snapshots(plan, 0)} == {"maniskill/PullCube-v1"}
