"""Plays scripted oracles for their tests."""

from itertools import product

import numpy as np

from robogauntlet.policies.oracles import scripts
from robogauntlet.suites.episode import SUCCESS_HOLD, RenderProfile, View

FAST = View(image_size=32, render_profile=RenderProfile.FAST)


def steps_to_success(simulator, task, seeds, *, noises=(0.0,), horizons=1):
    """Return the control steps until success has held for long enough, or None, for each seed with each noise.

    The oracle of a task (by its name in the simulator) plays for this number of `horizons` at most. A noise is the
    deviation of the executed motion, as a share of the largest in one step.
    """
    simulation = simulator.open(task, FAST)
    moving = [place for place, name in enumerate(simulation.action_spec.names) if not name.endswith("gripper")]
    steps = []
    for seed, noise in product(seeds, noises):
        script = scripts()[f"{simulator.name}/{task}"]()
        spec, generator, held, success = simulation.action_spec, np.random.default_rng(seed), 0, None
        simulation.reset(seed)
        for step in range(horizons * simulator.tasks[task].horizon):
            action = script(simulation.privileged_state())
            assert ((spec.low - 1e-12 <= action) & (action <= spec.high + 1e-12)).all()
            action[moving] += noise * spec.steps[moving] * generator.standard_normal(len(moving))
            held = held + 1 if simulation.step(np.clip(action, spec.low, spec.high)).success else 0
            if held == SUCCESS_HOLD:
                success = step + 1
                break
        steps.append(success)
    simulation.close()
    return steps
