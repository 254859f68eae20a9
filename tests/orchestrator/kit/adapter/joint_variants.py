"""Adapters whose actions have the targets of joints, with one violation each, see `.variants`."""

from dataclasses import replace

import numpy as np

from robogauntlet.adapters.contract import ActionSpec, Joint, StepOutcome
from robogauntlet.orchestrator.kit.template.adapter.robogauntlet_toysim.adapter import ToysimSimulation
from tests.orchestrator.kit.adapter.variants import VARIANTS, Variant

METRES = 0.1
"""By which a joint moves the tool for each radian: the first along x, the others along y and z."""
JOINTS = ("first", "second", "third")


class WithJoints(Variant):
    """Correct."""

    order = (0, 1, 2)
    unit = 1.0
    """Of the targets (rad)."""
    jacobian = METRES
    step_taken = 0.3
    """Largest change of a target (rad)."""
    beyond = False
    """Whether targets beyond the limits are followed."""

    def __init__(self, view):
        super().__init__(view)
        joints = tuple(Joint(name, -6.0, 6.0, 0.3) for name in JOINTS)
        self.action_spec = ActionSpec(0.0, 0.0, 20.0, joints=joints)

    def __init_subclass__(cls, joints=JOINTS, velocities=False):
        super().__init_subclass__()
        declared = VARIANTS[cls.__name__.lower()]
        tasks = {name: replace(task, joints=joints, velocities=velocities) for name, task in declared.tasks.items()}
        VARIANTS[declared.name] = replace(declared, tasks=tasks)

    def step(self, action):
        spec = self.action_spec
        target = (action if self.beyond else np.clip(action, spec.low, spec.high))[:-1]
        before = self.targets
        self.targets = before + np.clip(target - before, -self.step_taken, self.step_taken)
        change = self.targets[np.array(self.order)] * self.unit - self.angles
        self._world.step(METRES * np.resize([*change, 0.0], 3), np.zeros(3), closing=action[-1] > 0.0)
        return StepOutcome(reward=0.0, success=False)

    @property
    def angles(self):
        return self._world.tool[: len(self.order)] / METRES

    def reset(self, seed):
        super().reset(seed)
        self.targets = self.angles

    def observe(self):
        return ToysimSimulation.observe(self)

    def privileged_state(self):
        jacobian = self.jacobian * np.eye(6, len(self.order))
        opened = 1.0 - 2.0 * self._world.fingers[:1] / 0.04
        own = {"joint_angles": self.angles, "joint_targets": self.targets, "gripper": opened, "tcp_jacobian": jacobian}
        return dict(super().privileged_state()) | own


class JointsAreCorrect(WithJoints):
    pass


class Planar(WithJoints, joints=JOINTS[:2]):
    """Correct; its tool stays at a height."""

    order = (0, 1)

    def __init__(self, view):
        super().__init__(view)
        self.action_spec = replace(self.action_spec, joints=self.action_spec.joints[:2])


class Velocities(WithJoints, velocities=True):
    """Correct."""

    hz = 20.0

    def __init__(self, view):
        super().__init__(view)
        self.action_spec = replace(self.action_spec, velocities=True)

    def step(self, action):
        spec = self.action_spec
        targets = self.targets + np.clip(action, spec.low, spec.high)[:-1] / self.hz
        self.action_spec = replace(spec, velocities=False)
        try:
            return super().step(np.append(targets, action[-1]))
        finally:
            self.action_spec = spec


class VelocitiesPerStep(Velocities, velocities=True):
    hz = 1.0


class SaysTargets(Velocities):
    pass


class JointsInDegrees(WithJoints):
    unit = np.pi / 180.0


class JointsSwapped(WithJoints):
    order = (1, 0, 2)


class JacobianOfAnotherArm(WithJoints):
    jacobian = 2.0 * METRES


class JointsUnlimited(WithJoints):
    beyond = True


class SlowJoints(WithJoints):
    step_taken = 0.15


class OfATool(WithJoints):
    def observe(self):
        return replace(super().observe(), of_joints=False)


class OtherJoints(WithJoints, joints=("shoulder", "elbow", "wrist")):
    pass


class HidesTheTargets(WithJoints):
    def privileged_state(self):
        return {name: value for name, value in super().privileged_state().items() if name != "joint_targets"}
