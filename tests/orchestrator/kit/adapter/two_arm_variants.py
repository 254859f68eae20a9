"""Adapters of two arms, with one violation each, see `tests.orchestrator.kit.adapter.variants`."""

from dataclasses import replace

import numpy as np

from robogauntlet.adapters.contract import StepOutcome
from robogauntlet.orchestrator.kit.template.adapter.robogauntlet_toysim.adapter import ToysimSimulation
from robogauntlet.orchestrator.kit.template.adapter.robogauntlet_toysim.world import World
from tests.orchestrator.kit.adapter.variants import VARIANTS, Variant


class TwoArms(Variant):
    """Correct: each arm is in a world of its own."""

    forward = 1.0
    """Sign of the second arm's translations."""
    grips = True
    """Whether the second arm's fingers move."""

    def __init__(self, view):
        super().__init__(view)
        self._second = World()
        self.action_spec = replace(self.action_spec, arms=2)

    def __init_subclass__(cls, arms=2):
        super().__init_subclass__()
        declared = VARIANTS[cls.__name__.lower()]
        tasks = {name: replace(task, arms=arms) for name, task in declared.tasks.items()}
        VARIANTS[declared.name] = replace(declared, tasks=tasks)

    def reset(self, seed):
        super().reset(seed)
        self._second.reset(seed + 1)

    def step(self, action):
        first, second = np.split(np.clip(action, self.action_spec.low, self.action_spec.high), 2)
        self._world.step(first[:3], first[3:6], closing=first[6] > 0.0)
        self._second.step(self.forward * second[:3], second[3:6], closing=self.grips and second[6] > 0.0)
        return StepOutcome(reward=0.0, success=False)

    def observe(self):
        return ToysimSimulation.observe(self)

    def privileged_state(self):
        world = self._second
        own = {"tcp_position": world.tool, "tcp_quaternion": world.turn.as_quat(), "finger_positions": world.fingers}
        base = {"base_position": [1.0, 0.0, 0.0], "base_quaternion": [0.0, 0.0, 1.0, 0.0]}
        return dict(super().privileged_state()) | {f"second_{name}": np.array(v) for name, v in (own | base).items()}


class BothAreCorrect(TwoArms):
    pass


class SecondGoesBack(TwoArms):
    forward = -1.0


class SecondNeverGrips(TwoArms):
    grips = False


class SaysItHasOneArm(TwoArms, arms=1):
    pass


class HidesTheSecondBase(TwoArms):
    def privileged_state(self):
        state = super().privileged_state()
        return {name: value for name, value in state.items() if "base" not in name}


class HidesTheSecondArm(TwoArms):
    def privileged_state(self):
        return Variant.privileged_state(self)
