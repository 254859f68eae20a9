"""Plays the same actions by an adapter's control loop and by robosuite's own `step`, for the tests of both versions."""

import itertools

import numpy as np
import pytest
from threadpoolctl import threadpool_info

from robogauntlet.adapters.scene_control import DynamicsFactors


def check_compiled(simulation):
    """Assert that control steps are compiled; skip where NumPy's and SciPy's OpenBLAS take the processor for others."""
    kernels = {one["architecture"] for one in threadpool_info() if one["internal_api"] == "openblas"}
    if not simulation._control.exact and len(kernels) > 1:
        pytest.skip(f"this machine makes NumPy's and SciPy's OpenBLAS round differently: {', '.join(sorted(kernels))}")
    assert simulation._control.exact


def actions_of(seed):
    """Shares of the largest action: held, drawn anew, extreme, far beyond it, and zero; with every gripper command."""
    generator = np.random.default_rng(seed)
    held = np.repeat(generator.uniform(-1.0, 1.0, (3, 7)), 4, axis=0)
    extreme = generator.choice([-1.0, 0.0, 1.0], (6, 7))
    return np.concatenate([held, generator.uniform(-1.0, 1.0, (5, 7)), extreme, 20.0 * extreme[:1], np.zeros((1, 7))])


def perturb(simulation):
    before, scene_controls = simulation.privileged_state(), simulation.scene_controls
    scene_controls.arm.place_tool(before["tcp_position"] + [0.0, 0.05, 0.03], before["tcp_quaternion"])
    objects = scene_controls.objects.placeable() if scene_controls.objects else {}
    for name in itertools.islice(objects, 1):
        scene_controls.objects.move(name, np.array([0.01, -0.01]))
    scene_controls.dynamics.set_dynamics(DynamicsFactors(mass=2.0, friction=3.0))


def played(simulation, seed, step, *, perturbed=False):
    """Return state, solver's start, commands, time, reward and success after each action."""
    simulation.reset(seed)
    if perturbed:
        perturb(simulation)
    data, states = simulation._data, []
    for action in actions_of(seed):
        outcome = step(simulation, action * simulation.action_spec.high)
        states.append(np.concatenate([data.qpos, data.qvel, data.qacc_warmstart, data.ctrl, [data.time], outcome]))
    return np.array(states)


def ours(simulation, action):
    outcome = simulation.step(action)
    return outcome.reward, outcome.success


def robosuites(simulation, action):
    spec = simulation.action_spec
    _, reward, _, _ = simulation._env.step(np.clip(action, spec.low, spec.high) / spec.high)
    return reward, simulation._env._check_success()


def alternating():
    turns = itertools.cycle((ours, robosuites))
    return lambda simulation, action: next(turns)(simulation, action)
