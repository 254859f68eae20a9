"""Adapters whose numbers are the environment's own, with one violation each, see `.variants`."""

from dataclasses import replace

import numpy as np

from robogauntlet.adapters.contract import ActionSpec, Number, StepOutcome
from robogauntlet.adapters.scene_control import SceneControls
from robogauntlet.orchestrator.kit.template.adapter.robogauntlet_toysim.adapter import ToysimSimulation
from tests.orchestrator.kit.adapter.variants import VARIANTS, Variant

NUMBERS = tuple(Number(name, -40.0, 90.0) for name in ("east", "north", "height"))
STATE = ("east", "north", "height", "speed")


class IsNative(Variant):
    """Correct: places in centimetres, to which the tool goes."""

    bounds = np.array([-40.0, 90.0])

    def __init__(self, view):
        super().__init__(view)
        self.action_spec = ActionSpec(0.0, 0.0, 20.0, numbers=NUMBERS, state=STATE)
        self.scene_controls = SceneControls()

    def __init_subclass__(cls, native=tuple(number.name for number in NUMBERS)):
        super().__init_subclass__()
        name = cls.__name__.lower()
        tasks = {
            task: replace(declared, goal=None, native=native, state=STATE)
            for task, declared in VARIANTS[name].tasks.items()
        }
        VARIANTS[name] = replace(VARIANTS[name], tasks=tasks, adjusts=frozenset())

    def step(self, action):
        way = np.clip(action, *self.bounds) / 100.0 - self._world.tool
        self.speed = float(np.linalg.norm(way))
        self._world.step(np.clip(way, -0.02, 0.02), np.zeros(3), closing=False)
        return StepOutcome(reward=0.0, success=False)

    def reset(self, seed):
        super().reset(seed)
        self.speed = 0.0

    def observe(self):
        return ToysimSimulation.observe(self)

    def privileged_state(self):
        place = 100.0 * self._world.tool
        return {"state": np.append(place, self.speed), "still": place, "ball_position": self._world.ball.copy()}


class NativeIsCorrect(IsNative):
    pass


class Unbounded(IsNative):
    """Correct."""

    bounds = np.array([-np.inf, np.inf])

    def __init__(self, view):
        super().__init__(view)
        numbers = tuple(Number(number.name) for number in NUMBERS)
        self.action_spec = replace(self.action_spec, numbers=numbers)


class FollowsBeyond(IsNative):
    bounds = np.array([-np.inf, np.inf])


class OtherNumbers(IsNative, native=("x", "y", "z")):
    pass


class HidesWhatIsStill(IsNative):
    def privileged_state(self):
        return {name: value for name, value in super().privileged_state().items() if name != "still"}


class OfARobot(IsNative):
    def observe(self):
        return replace(super().observe(), native=None)


class ReadsElsewhere(IsNative):
    def observe(self):
        seen = super().observe()
        return replace(seen, proprioception=seen.proprioception + 1.0)
