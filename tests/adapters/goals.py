"""Measures episodes by the goals that tasks declare."""

import numpy as np

from robogauntlet.adapters.goals import goal_distance
from robogauntlet.adapters.motion import motion_reader
from robogauntlet.policies.oracles import scripts
from robogauntlet.suites.episode import SUCCESS_HOLD

NEAR = 0.06
"""Distance of the tool from the handle at which it has reached it (m)."""


def oracle_actions(simulator, task, simulation, seed):
    """The actions with which the oracle succeeds in the open task, or None."""
    script, spec, actions, held = scripts()[f"{simulator.name}/{task}"](), simulation.action_spec, [], 0
    simulation.reset(seed)
    while held < SUCCESS_HOLD and len(actions) < simulator.tasks[task].horizon:
        actions.append(np.clip(script(simulation.privileged_state()), spec.low, spec.high))
        held = held + 1 if simulation.step(actions[-1]).success else 0
    return actions if held == SUCCESS_HOLD else None


def motions(simulation, entries, actions):
    """Yield the motion now and after each action."""
    read = motion_reader(simulation)
    yield read(entries)
    for action in actions:
        simulation.step(action)
        yield read(entries)


def measure(simulation, goal, actions):
    """Progress at the end of these actions, and the smallest distance of the tool from the handle (m)."""
    entries, distances, reached = [goal.entry, goal.to or goal.entry, goal.handle or goal.entry], [], []
    for motion in motions(simulation, entries, actions):
        moved, target, handle = motion.entries
        distances.append(max(0.0, goal_distance(goal, moved, target) - goal.tolerance))
        reached.append(np.linalg.norm(motion.tool - handle))
    return 1.0 - distances[-1] / distances[0], min(reached)


def check_goal(simulator, task, simulation, seed, *, idle=0.1, steps=40):
    """Assert that the oracle's success is progress and comes by the handle, and that idling is no progress."""
    goal, actions = simulator.tasks[task].goal, oracle_actions(simulator, task, simulation, seed)
    simulation.reset(seed)
    progress, reached = measure(simulation, goal, actions)
    assert progress >= 0.9
    assert reached <= NEAR
    simulation.reset(seed)
    assert measure(simulation, goal, np.zeros((steps, 7)))[0] <= idle
