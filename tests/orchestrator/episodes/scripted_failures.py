"""Policies that fail in a known way, made of the oracles, and the kind of failure that a person would give each."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np

from robogauntlet.adapters.catalog import goal_of, task_descriptions
from robogauntlet.adapters.contract import FloatArray, Goal, Simulation
from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.policies.contract import Decision, PolicyInput, PolicySpec, Query, StatelessPolicy
from robogauntlet.policies.oracles import scripts
from robogauntlet.policies.oracles.motion import Script, State
from robogauntlet.results.record import EpisodeResult, FailureKind
from robogauntlet.suites.episode import Episode, Protocol, RenderProfile, View

UP = np.array([0.0, 0.0, 1.0])
SLOW = 0.15
"""Share of the oracle's motion with which it is still on its way at the horizon."""
ASIDE = {"maniskill/StackCube-v1": (0.0, 0.12, -0.04), "robosuite/Stack": (0.0, 0.12, -0.045)}
"""From the goal's true place to a wrong one that the oracle is given (m), on the table."""
ELSEWHERE = (0.0, 0.25, 0.0)
TASKS = (
    *("maniskill/PushCube-v1", "maniskill/PullCube-v1", "maniskill/StackCube-v1"),
    *("pybullet/PandaReach-v3", "pybullet/PandaPush-v3", "pybullet/PandaPickAndPlace-v3"),
    *("robosuite/Lift", "robosuite/Stack", "robosuite/Door"),
)
VIEW = View(("third_person",), 96, RenderProfile.FAST)


class Acting(StatelessPolicy):
    """Acts by a script."""

    spec = PolicySpec(PolicyInput.PRIVILEGED_STATE, chunk_length=1)

    def __init__(self, script: Script) -> None:
        self._script = script

    def act(self, queries: Sequence[Query]) -> Sequence[Decision]:
        return [Decision(np.asarray(self._script(query.privileged_state))[None]) for query in queries]


def failures(task: str, simulation: Simulation) -> Iterator[tuple[FailureKind, Script]]:
    """Yield each kind of failure that the task can have, and a new script that fails so. After a reset."""
    goal = goal_of(task)
    assert goal is not None
    start, step = simulation.privileged_state(), simulation.action_spec.max_translation
    yield FailureKind.TIMED_OUT, partial(slowly, task)
    if goal.entry == "tcp_position":
        away = start["tcp_position"] + UP * 0.1 - 0.15 * np.sign(start["goal_position"])
        leave = partial(towards, place=away, step=step / 2)
        yield FailureKind.MISPLACED, Turning(scripts()[task](), at_goal, leave)
        yield FailureKind.NOT_REACHED, leave
        return
    handle = goal.handle or goal.entry
    yield FailureKind.NOT_REACHED, still
    if task != "robosuite/Door":  # which has no table
        beside = start[handle] + np.array([0.0, -0.12 if start[handle][1] > 0 else 0.12, 0.1])
        approach = partial(towards, place=beside, step=step / 2)
        yield FailureKind.UNSAFE, Turning(approach, partial(is_over, place=beside), partial(press, step=step))
    if goal.grasped:
        yield FailureKind.NOT_GRASPED, partial(with_open_gripper, task)
        # robosuite drops Lift's cube onto the table, and takes 2 cm for lifted.
        height = start[handle][2] + (0.03 if goal.to else 0.006 - 0.01)
        yield FailureKind.DROPPED, Turning(scripts()[task](), partial(carries, goal=goal, height=height), still)
    else:
        yield FailureKind.NOT_MOVED, partial(hover, handle=handle, step=step / 3)
    if task == "robosuite/Door":
        yield FailureKind.MISPLACED, Turning(scripts()[task](), is_ajar, partial(still, gripper=1.0))
    elif goal.to:
        yield FailureKind.MISPLACED, misled(task, goal, ASIDE.get(task, ELSEWHERE))


class Turning:
    """A script that acts by one and, once `when` is true, by another for good."""

    def __init__(self, first: Script, when: Callable[[State], bool], then: Script) -> None:
        self._script, self._when, self._then = first, when, then

    def __call__(self, state: State) -> FloatArray:
        if self._when(state):
            self._script = self._then
        return self._script(state)


def still(state: State, gripper: float = -1.0) -> FloatArray:
    return np.array([0.0] * 6 + [gripper])


def press(state: State, step: float) -> FloatArray:
    return np.concatenate([-UP * step, np.zeros(3), [1.0]])


def towards(state: State, place: FloatArray, step: float) -> FloatArray:
    way = place - state["tcp_position"]
    length = float(np.linalg.norm(way))
    return np.concatenate([way * min(1.0, step / max(length, 1e-9)), np.zeros(3), [1.0]])


def hover(state: State, handle: str, step: float) -> FloatArray:
    return towards(state, state[handle] + 0.05 * UP, step)


def slowly(task: str, state: State) -> FloatArray:
    """The oracle's action, slower. The scripts depend on the state alone."""
    return scripts()[task]()(state) * np.array([SLOW] * 6 + [1.0])


def with_open_gripper(task: str, state: State) -> FloatArray:
    return np.append(scripts()[task]()(state)[:6], -1.0)


def at_goal(state: State) -> bool:
    return float(np.linalg.norm(state["tcp_position"] - state["goal_position"])) < 0.04


def is_over(state: State, place: FloatArray) -> bool:
    return float(np.linalg.norm((state["tcp_position"] - place)[:2])) < 0.01


def is_ajar(state: State) -> bool:
    return float(state["hinge_angle"][0]) > 0.1


def carries(state: State, goal: Goal, height: float) -> bool:
    """Whether the object is in the hand, this high, and far from the goal."""
    place = state[goal.entry]
    in_hand = np.linalg.norm(place - state["tcp_position"]) < 0.03
    far = not goal.to or np.linalg.norm((place - state[goal.to])[:2]) > 0.085
    return bool(in_hand and far and place[2] > height)


def misled(task: str, goal: Goal, offset: tuple[float, ...]) -> Script:
    """The oracle, told that the goal is elsewhere: at an offset, to the side where the object is not."""
    oracle = scripts()[task]()
    side: list[float] = []

    def act(state: State) -> FloatArray:
        if not side:
            side.append(-1.0 if state[goal.entry][1] > state[goal.to][1] else 1.0)
        moved = np.array(offset) * (1.0, side[0], 1.0)
        return oracle(dict(state) | {goal.to: state[goal.to] + moved})

    return act


def play_failures(task: str, simulation: Simulation, seed: int) -> Iterator[tuple[FailureKind, EpisodeResult]]:
    """Play each failure of a task's seed; yield the kind that it was made for, and its record."""
    horizon = task_descriptions()[task].horizon
    episode = Episode("scripted", "scripted", task, seed, Protocol(horizon, 1, VIEW))
    simulation.reset(seed)
    for kind, script in list(failures(task, simulation)):
        yield kind, rollout(simulation, Acting(script), episode)
