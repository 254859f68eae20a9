"""Adapters that break the contract, each in one way: variants of the toy of `robogauntlet new adapter`."""

import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace

import gymnasium
import numpy as np

from robogauntlet.adapters.contract import AdapterError, Goal, Motion, SimulatorUnavailable
from robogauntlet.adapters.frames import proprioception
from robogauntlet.orchestrator.kit.template.adapter.robogauntlet_toysim import adapter
from robogauntlet.orchestrator.kit.template.adapter.robogauntlet_toysim.adapter import ToysimSimulation
from robogauntlet.orchestrator.kit.template.adapter.robogauntlet_toysim.world import World

VARIANTS = {}
KEPT = []


class Variant(ToysimSimulation):
    """Registers each subclass under its name; `Correct` breaks nothing."""

    def __init__(self, view):
        super().__init__(World(), adapter.TASKS["Reach"], view)

    def observe(self):
        """Proprioception is that of the correct privileged state, so that a violation affects only one of them."""
        return replace(super().observe(), proprioception=proprioception(ToysimSimulation.privileged_state(self)))

    def __init_subclass__(cls):
        name = cls.__name__.lower()
        VARIANTS[name] = replace(
            adapter.SIMULATOR, name=name, modules=(), distributions=(), open=lambda task, view: cls(view)
        )


class Correct(Variant):
    pass


def _images(change):
    return lambda seen: replace(seen, images={camera: change(image) for camera, image in seen.images.items()})


def _state(change):
    return lambda state: {name: change(name, value) for name, value in state.items()}


def _success(success):
    return lambda outcome: replace(outcome, success=success)


CHANGED_RESULTS = {
    "WrongShape": ("observe", _images(lambda image: np.dstack([image, image[..., :1]]))),
    "WrongType": ("observe", _images(lambda image: image.astype(np.float32) / 255)),
    "BlackImages": ("observe", _images(lambda image: image * 0)),
    "Flickers": ("observe", _images(lambda image: image ^ np.uint8(os.urandom(1)[0]))),
    "PictureUpsideDown": ("picture", lambda picture: picture[::-1].copy()),
    "Degrees": (
        "observe",
        lambda seen: replace(seen, proprioception=seen.proprioception * np.repeat([1.0, 180 / np.pi, 1.0], [3, 3, 2])),
    ),
    "OtherWords": ("observe", lambda seen: replace(seen, instruction="do something")),
    "SinglePrecision": ("privileged_state", _state(lambda name, value: value.astype(np.float32))),
    "Centimetres": ("privileged_state", _state(lambda name, value: value * 100 if "position" in name else value)),
    "WorldFrame": (
        "privileged_state",
        _state(lambda name, value: value - [0.6, 0, 0] if name == "tcp_position" else value),
    ),
    "ScalarFirst": ("privileged_state", _state(lambda name, value: np.roll(value, 1) if "quat" in name else value)),
    "ConstantHash": ("state_hash", lambda correct: "0" * 16),
    "NumpyBool": ("step", _success(np.bool_(False))),
    "AlwaysSuccess": ("step", _success(True)),
    "NeverSuccess": ("step", _success(False)),
}
"""Variants with a method whose correct result is changed."""
ACTION_FACTORS = {
    "ActsInCentimetres": np.repeat([0.01, 1.0], [3, 4]),
    "ActsInDegrees": np.repeat([1.0, np.pi / 180, 1.0], [3, 3, 1]),
    "FlippedY": np.array([1.0, -1.0, 1.0, 1.0, 1.0, 1.0, 1.0]),
    "OpensAtPlusOne": np.array([1.0, 1.0, 1.0, 1.0, 1.0, 1.0, -1.0]),
    "IgnoresInSecret": np.array([1.0, 1.0, 1.0, 0.0, 1.0, 1.0, 1.0]),
}
"""Variants that execute an action multiplied by factors."""


def _with_result(name, method, change):
    type(name, (Variant,), {method: lambda self, *arguments: change(getattr(Variant, method)(self, *arguments))})


def _with_factors(name, factors):
    type(name, (Variant,), {"step": lambda self, action: Variant.step(self, action * factors)})


for _name, _changed in CHANGED_RESULTS.items():
    _with_result(_name, *_changed)
for _name, _factors in ACTION_FACTORS.items():
    _with_factors(_name, _factors)

# Goal and motion


def _with_goal(name, goal):
    task = replace(adapter.TASKS["Reach"], goal=goal)
    VARIANTS[name] = replace(VARIANTS["correct"], name=name, tasks={"Reach": task})


_with_goal("nogoal", None)
_with_goal("goalmisspelt", Goal("tcp_position", "bal_position"))
_with_goal("goalofanangle", Goal("finger_positions", offset=(0.01,), axes="xy", handle="tcp_position"))
_with_goal("goalreached", Goal("tcp_position", "ball_position", tolerance=2.0))


class Moves(Variant):
    def motion(self, entries):
        state = ToysimSimulation.privileged_state(self)
        opening = float(state["finger_positions"].sum())
        return Motion(state["tcp_position"], opening, tuple(state[entry] for entry in entries), 0.0, 0.5)


class MotionElsewhere(Moves):
    def motion(self, entries):
        return replace(super().motion(entries), tool=self._world.tool + 0.02)


class MotionOfFewer(Moves):
    def motion(self, entries):
        return super().motion(entries[:1])


class MotionSteps(Moves):
    def motion(self, entries):
        self._world.tool[2] += 0.001
        return super().motion(entries)


class MotionPulls(Moves):
    def motion(self, entries):
        return replace(super().motion(entries), contact_force=-1.0)


# Exceptions


class RaisesAtOpen(Variant):
    def __init__(self, view):
        raise SimulatorUnavailable("no licence for the engine: run `licence --renew`")


class RaisesInObserve(Variant):
    def observe(self):
        raise KeyError("agentview")


# Seeds


class Unseeded(Variant):
    def reset(self, seed):
        super().reset(seed)
        self._world.ball[0] += np.random.uniform(0.0, 0.01)


class SameForAll(Variant):
    def reset(self, seed):
        super().reset(0)


class KeepsFingers(Variant):
    def reset(self, seed):
        fingers = getattr(self._world, "fingers", None)
        super().reset(seed)
        if fingers is not None:
            self._world.fingers = fingers


class DriftsUnseen(Variant):
    """By less than the state hash shows, as a warm start of a solver would."""

    drift = 0.0

    def reset(self, seed):
        super().reset(seed)
        DriftsUnseen.drift += 1e-10
        self._world.tool[0] += DriftsUnseen.drift


class ByProcess(Variant):
    def reset(self, seed):
        super().reset(seed)
        self._world.ball[0] += os.getpid() % 1000 * 1e-5


class OneWorld(Variant):
    world = World()

    def __init__(self, view):
        super().__init__(view)
        self._world = OneWorld.world


# Looking


class ObservingSteps(Variant):
    def observe(self):
        self.step(np.array([0.0, 0.0, -0.001, 0.0, 0.0, 0.0, -1.0]))
        return super().observe()


class Stale(Variant):
    def reset(self, seed):
        super().reset(seed)
        self._first = super().observe().images

    def observe(self):
        return replace(super().observe(), images=self._first)


class OneBuffer(Variant):
    def observe(self):
        seen = super().observe()
        if not hasattr(self, "_buffers"):
            self._buffers = {camera: np.empty_like(image) for camera, image in seen.images.items()}
        for camera, image in seen.images.items():
            self._buffers[camera][:] = image
        return replace(seen, images=self._buffers)


class DrawsInStep(Variant):
    def step(self, action):
        self.observe()
        return super().step(action)


# Actions


class ToolFrame(Variant):
    def step(self, action):
        return super().step(np.concatenate([self._world.turn.apply(action[:3]), action[3:]]))


class TurnsInToolFrame(Variant):
    def step(self, action):
        turned = self._world.turn.apply(action[3:6])
        return super().step(np.concatenate([action[:3], turned, action[6:]]))


class ActsThoughIgnored(Variant):
    def __init__(self, view):
        super().__init__(view)
        self.action_spec = replace(self.action_spec, ignored=("gripper",))


class Unclipped(Variant):
    def step(self, action):
        self._world.tool = self._world.tool + np.sign(action[:3]) * np.maximum(np.abs(action[:3]) - 0.03, 0.0)
        return super().step(action)


class ClipsInPlace(Variant):
    def step(self, action):
        action *= 0.5
        return super().step(action)


class EndsAtHorizon(Variant):
    def reset(self, seed):
        super().reset(seed)
        self._left = 60

    def step(self, action):
        self._left -= 1
        if self._left < 0:
            raise ValueError("executing action in terminated episode")
        return super().step(action)


class EndsEarly(Variant):
    def reset(self, seed):
        super().reset(seed)
        self._left = 6

    def step(self, action):
        self._left -= 1
        assert self._left >= 0, "stepped past the end"
        return replace(super().step(action), terminated=self._left == 0)


class PlaysOn(Variant):
    """Wraps an environment of gymnasium that says when an episode has ended."""

    heeds = False

    def __init__(self, view):
        super().__init__(view)
        self._inner = gymnasium.make("CartPole-v1").unwrapped

    def reset(self, seed):
        super().reset(seed)
        self._inner.reset(seed=seed)
        self._inner.state = np.array([0.0, 0.0, 0.15, 0.0])

    def step(self, action):
        _, _, terminated, _, _ = self._inner.step(0)
        return replace(super().step(action), terminated=terminated and self.heeds)


class EndsWithIt(PlaysOn):
    heeds = True


class OnlyMovesAlongX(Variant):
    def __init__(self, view):
        super().__init__(view)
        self.action_spec = replace(self.action_spec, ignored=("dy", "dz"))

    def step(self, action):
        return super().step(action * [1.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0])


# What is taken and not given back


class KeepsMemory(Variant):
    def reset(self, seed):
        super().reset(seed)
        KEPT.append(os.urandom(1 << 10) * 100)


class KeepsFiles(Variant):
    def __init__(self, view):
        super().__init__(view)
        KEPT.append(os.open(os.devnull, os.O_RDONLY))


class KeepsThreads(Variant):
    def __init__(self, view):
        super().__init__(view)
        threading.Thread(target=time.sleep, args=(20,), daemon=True).start()


class KeepsProcesses(Variant):
    def __init__(self, view):
        super().__init__(view)
        subprocess.Popen([sys.executable, "-S", "-c", f"import time; time.sleep(20)  # of {os.getpgrp()}"])


class ClosesOnce(Variant):
    def close(self):
        if getattr(self, "_closed", False):
            raise AdapterError("already closed")
        self._closed = True


class Dies(Variant):
    def step(self, action):
        os.kill(os.getpid(), signal.SIGKILL)


class Hangs(Variant):
    def step(self, action):
        time.sleep(60)


class Slow(Variant):
    def step(self, action):
        time.sleep(0.03)
        return super().step(action)
