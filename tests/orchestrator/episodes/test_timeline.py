"""What the robot does while answers take simulated time."""

import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from robogauntlet.adapters.catalog import open_simulation
from robogauntlet.adapters.contract import Moves
from robogauntlet.adapters.motion import holding
from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.orchestrator.episodes.timeline import Timeline
from robogauntlet.policies.contract import Decision, PolicyInput, PolicySpec, StatelessPolicy
from robogauntlet.results.record import WAITING, EpisodeResult, outcome_row
from robogauntlet.suites.episode import Condition, Episode, Protocol, View
from robogauntlet.suites.timing import Timing, TimingMode
from tests.orchestrator.runs.playing import SUITE, play

SPEC = open_simulation("null/Reach", View()).action_spec
MODES = {TimingMode.HOLD: "latency", TimingMode.CONTINUE: "latency-continue", TimingMode.BLEND: "latency-blend"}


class Counted(StatelessPolicy):
    """Answers with chunks whose first number says the query and the row, and remembers when it was asked."""

    def __init__(self, length=8, sleep_s=0.0):
        self.spec = PolicySpec(PolicyInput.OBSERVATION, length)
        self.length, self.sleep_s, self.asked = length, sleep_s, []

    def act(self, queries):
        time.sleep(self.sleep_s)
        self.asked += [query.step for query in queries]
        chunk = np.zeros((self.length, 7))
        chunk[:, 0] = [(len(self.asked) * 100 + row) * 1e-6 for row in range(self.length)]
        chunk[:, 6] = 1.0
        return [Decision(chunk) for _ in queries]


class Recorded:
    """The null simulation; records the executed actions."""

    def __init__(self):
        self.inner, self.actions = open_simulation("null/Reach", View()), []
        self.action_spec, self.observation_spec = self.inner.action_spec, self.inner.observation_spec

    def step(self, action):
        self.actions.append(action.copy())
        return self.inner.step(action)

    def __getattr__(self, name):
        return getattr(self.inner, name)


def episode(timing=None, condition=None, horizon=24, replan_every=4):
    protocol = Protocol(horizon, replan_every, timing=timing)
    return Episode("p", "p", "null/Reach", 3, protocol, condition or Condition())


def played(one, policy=None):
    simulation = Recorded()
    result = rollout(simulation, policy or Counted(), one)
    return [None if not action[0] else round(action[0] * 1e6) for action in simulation.actions], result


def steps_of(timing):
    """Control steps of 50 ms."""
    return Timing(TimingMode(timing[0]), 50 * timing[1])


def test_a_robot_that_holds_waits_and_then_executes_the_answer_from_its_beginning():
    actions, result = played(episode(steps_of(("hold", 2)), horizon=12))
    assert actions == [None, None, 100, 101, 102, 103, None, None, 200, 201, 202, 203]
    assert (result.held_steps, result.stale_steps, result.chunk_share) == (4, 0, 0.5)
    assert result.observation_age == pytest.approx(0.05 * (2 + 3 + 4 + 5) / 4, abs=1e-3)


def test_a_robot_that_continues_executes_the_rest_and_then_the_action_that_is_due():
    actions, result = played(episode(steps_of(("continue", 2)), horizon=12))
    assert actions == [None, None, 100, 101, 102, 103, 202, 203, 204, 205, 302, 303]
    assert (result.held_steps, result.stale_steps) == (2, 4)


def test_a_robot_that_blends_moves_evenly_from_the_old_answer_to_the_new_and_its_gripper_follows_the_new():
    old, new = np.zeros((6, 7)), np.ones((6, 7))
    old[:, 6] = -1.0
    timeline = Timeline(episode(steps_of(("blend", 1)), replan_every=3), SPEC)
    timeline.segment(old)
    second = timeline.segment(new)
    # three of the old answer's actions are left over for times that the new one has, too
    assert second.actions[0, 0] == 0.0
    assert second.actions[1:, 0].tolist() == [1 / 4, 2 / 4]
    assert set(second.actions[1:, 6]) == {1.0}


def test_a_robot_asks_so_early_that_the_answer_comes_when_the_last_one_is_used_up():
    actions, _ = played(episode(steps_of(("continue", 2)), horizon=14, replan_every=8), Counted(length=8))
    assert None not in actions[2:]


@pytest.mark.parametrize("mode", MODES)
def test_a_latency_of_less_than_half_a_step_gives_the_rows_of_a_simulation_that_waits(mode):
    waits, clean = played(episode())
    actions, result = played(episode(Timing(mode, 20)))
    assert actions == waits
    same = replace(result, **dict.fromkeys(WAITING), timing=None, episode_id=clean.episode_id, pair_id=clean.pair_id)
    assert outcome_row(same) == outcome_row(clean)


@pytest.mark.parametrize("mode", MODES)
def test_the_axis_adds_to_the_timing_of_the_suite(mode):
    both, with_axis = played(episode(steps_of((mode, 1)), Condition(MODES[mode], 2)))
    alone, plain = played(episode(steps_of((mode, 3))))
    assert both == alone
    assert with_axis.actions_hash == plain.actions_hash
    assert with_axis.delivered == 100.0
    assert with_axis.timing == f"{mode}:50ms"


def test_a_slow_policy_has_the_rows_of_a_quick_one_since_only_modelled_time_counts():
    timing = Timing(TimingMode.CONTINUE, 80, 140)
    rows = [outcome_row(played(episode(timing), Counted(sleep_s=s))[1]) for s in (0.0, 0.02)]
    assert rows[0] == rows[1]


def test_random_answer_times_depend_on_the_pair_alone():
    one = episode(Timing(TimingMode.HOLD, 100, 300), horizon=80)
    held = [played(other)[0] for other in (one, replace(one, policy_digest="q"), replace(one, seed=4))]
    assert held[0] == held[1] != held[2]


def test_a_row_keeps_the_timing_of_its_episode():
    one = episode(Timing(TimingMode.BLEND, 80, 140))
    row = EpisodeResult.failed_to_run(one, "")
    assert row.timing == "blend:80-140ms"
    assert row.episode == one
    assert row.episode.id == one.id != episode().id


@pytest.mark.parametrize(("moves", "expected"), [(Moves.TOOL, [0.0] * 6 + [1.0]), (Moves.TARGETS, [0.1] * 6 + [1.0])])
def test_holding_is_no_motion_or_the_last_targets_with_the_gripper_as_commanded(moves, expected):
    names = (*(f"joint_{number}" for number in range(6)), "gripper")
    simulation = SimpleNamespace(
        action_spec=SimpleNamespace(numbers=(), names=names, body=SimpleNamespace(moves=moves))
    )
    assert holding(simulation, np.array([0.1] * 6 + [1.0])).tolist() == expected


def reference(mode, lengths, delays, replan_every, horizon):
    """The executed (query, row) of each step, None for holding: clocked step by step."""
    executed, time_now, plan, query = [], 0, [], 0
    while len(executed) < horizon:
        length, delay, asked = lengths[query % len(lengths)], delays[query % len(delays)], time_now
        used = 0
        for _ in range(delay):
            goes_on = mode != "hold" and plan
            used += bool(goes_on)
            executed.append(plan.pop(0) if goes_on else None)
            time_now += 1
        plan = [(query, row) for row in range(used, length)]
        since = 0
        while plan and since < replan_every:
            if mode != "hold" and (time_now - asked >= replan_every or len(plan) <= delay):
                break
            executed.append(plan.pop(0))
            time_now, since = time_now + 1, since + 1
        if mode == "hold":
            plan = []
        query += 1
    return executed[:horizon]


@settings(max_examples=1000)
@given(
    st.sampled_from(["hold", "continue"]),
    st.lists(st.integers(1, 9), min_size=1, max_size=6),
    st.lists(st.integers(0, 12), min_size=1, max_size=6),
    st.integers(1, 10),
)
def test_any_schedule_of_answers_is_played_as_a_clock_of_single_steps_plays_it(mode, lengths, delays, replan_every):
    timeline = Timeline(episode(Timing(TimingMode(mode), 50), replan_every=replan_every), SPEC)
    asked = iter(range(1000))
    executed = []
    for query in asked:
        timeline._latency_steps = lambda query=query: delays[query % len(delays)]
        rows = np.zeros((lengths[query % len(lengths)], 7))
        rows[:, 0], rows[:, 1] = query, range(len(rows))
        segment = timeline.segment(rows)
        steps = zip(segment.actions, segment.held, strict=True)
        executed += [None if held else (int(action[0]), int(action[1])) for action, held in steps]
        if len(executed) >= 60:
            break
    assert executed[:60] == reference(mode, lengths, delays, replan_every, 60)


@pytest.mark.ray
@pytest.mark.usefixtures("ray_here")
def test_the_number_of_workers_changes_no_row(tmp_path):
    hashes = []
    for workers in (1, 3):
        file = tmp_path / f"{workers}.yaml"
        file.write_text(SUITE.replace("workers: 1", f"workers: {workers}") + "timing: continue:80-140ms\n")
        hashes.append(play(file, tmp_path / str(workers)).document.rows_hash)
    assert hashes[0] == hashes[1] is not None
