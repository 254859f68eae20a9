"""Plays scripted oracles for their tests."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from robogauntlet.adapters.contract import Simulation
from robogauntlet.suites.episode import SUCCESS_HOLD

Script = Callable[..., NDArray[np.float64]]


def steps_to_success(simulation: Simulation, script: Script, seed: int, horizon: int, noise: float = 0.0) -> int | None:
    """Control steps until success has held for long enough, or None.

    Args:
        simulation: Of the script's task.
        script: A new one.
        seed: Of the start and of the noise.
        horizon: Control steps at most.
        noise: Deviation of the executed motion, as a share of the largest in one step.
    """
    spec, generator, held = simulation.action_spec, np.random.default_rng(seed), 0
    simulation.reset(seed)
    for step in range(horizon):
        action = script(simulation.privileged_state())
        assert (abs(action) <= spec.high + 1e-12).all()
        action[:6] += noise * spec.high[:6] * generator.standard_normal(6)
        held = held + 1 if simulation.step(np.clip(action, spec.low, spec.high)).success else 0
        if held == SUCCESS_HOLD:
            return step + 1
    return None
