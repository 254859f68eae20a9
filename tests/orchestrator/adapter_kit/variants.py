"""Adapters that break the contract, each in one way: variants of the toy of `robogauntlet adapters new`."""

import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace

import numpy as np

from robogauntlet.adapters.contract import AdapterError, SimulatorUnavailable
from robogauntlet.adapters.frames import proprioception
from robogauntlet.orchestrator.adapter_kit.scaffold.template.robogauntlet_toysim import adapter
from robogauntlet.orchestrator.adapter_kit.scaffold.template.robogauntlet_toysim.adapter import ToysimSimulation
from robogauntlet.orchestrator.adapter_kit.scaffold.template.robogauntlet_toysim.world import World

VARIANTS = {}
KEPT = []


class Variant(ToysimSimulation):
    """Registers each subclass under its name."""

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


# Types, shapes, units


class WrongShape(Variant):
    def observe(self):
        seen = super().observe()
        return replace(seen, images={c: np.dstack([i, i[..., :1]]) for c, i in seen.images.items()})


class WrongType(Variant):
    def observe(self):
        seen = super().observe()
        return replace(seen, images={c: i.astype(np.float32) / 255 for c, i in seen.images.items()})


class SinglePrecision(Variant):
    def privileged_state(self):
        return {name: value.astype(np.float32) for name, value in super().privileged_state().items()}


class Centimetres(Variant):
    def privileged_state(self):
        return {n: v * 100 if "position" in n else v for n, v in super().privileged_state().items()}


class Degrees(Variant):
    def observe(self):
        seen = super().observe()
        return replace(seen, proprioception=seen.proprioception * np.repeat([1.0, 180 / np.pi, 1.0], [3, 3, 2]))


class WorldFrame(Variant):
    def privileged_state(self):
        return {n: v - [0.6, 0, 0] if n == "tcp_position" else v for n, v in super().privileged_state().items()}


class ScalarFirst(Variant):
    def privileged_state(self):
        return {n: np.roll(v, 1) if "quat" in n else v for n, v in super().privileged_state().items()}


class NumpyBool(Variant):
    def step(self, action):
        return replace(super().step(action), success=np.bool_(False))


class ConstantHash(Variant):
    def state_hash(self):
        return "0" * 16


class OtherWords(Variant):
    def observe(self):
        return replace(super().observe(), instruction="do something")


class BlackImages(Variant):
    def observe(self):
        seen = super().observe()
        return replace(seen, images={camera: image * 0 for camera, image in seen.images.items()})


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
    """Less than the state hash tells: as a warm start of a solver would."""

    drift = 0.0

    def reset(self, seed):
        super().reset(seed)
        DriftsUnseen.drift += 1e-10
        self._world.tool[0] += DriftsUnseen.drift


class Flickers(Variant):
    def observe(self):
        seen = super().observe()
        return replace(seen, images={c: i ^ np.uint8(os.urandom(1)[0]) for c, i in seen.images.items()})


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


class LookingSteps(Variant):
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


class ActsInCentimetres(Variant):
    def step(self, action):
        return super().step(action * np.repeat([0.01, 1.0], [3, 4]))


class ActsInDegrees(Variant):
    def step(self, action):
        return super().step(action * np.repeat([1.0, np.pi / 180, 1.0], [3, 3, 1]))


class FlippedY(Variant):
    def step(self, action):
        return super().step(action * np.array([1.0, -1.0, 1.0, 1.0, 1.0, 1.0, 1.0]))


class ToolFrame(Variant):
    def step(self, action):
        return super().step(np.concatenate([self._world.turn.apply(action[:3]), action[3:]]))


class TurnsInToolFrame(Variant):
    def step(self, action):
        turned = self._world.turn.apply(action[3:6])
        return super().step(np.concatenate([action[:3], turned, action[6:]]))


class OpensAtPlusOne(Variant):
    def step(self, action):
        return super().step(action * np.array([1.0, 1.0, 1.0, 1.0, 1.0, 1.0, -1.0]))


class IgnoresInSecret(Variant):
    def step(self, action):
        return super().step(action * np.array([1.0, 1.0, 1.0, 0.0, 1.0, 1.0, 1.0]))


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


# Success


class AlwaysSuccess(Variant):
    def step(self, action):
        return replace(super().step(action), success=True)


class NeverSuccess(Variant):
    def step(self, action):
        return replace(super().step(action), success=False)


class EndsAtHorizon(Variant):
    def reset(self, seed):
        super().reset(seed)
        self._left = 60

    def step(self, action):
        self._left -= 1
        if self._left < 0:
            raise ValueError("executing action in terminated episode")
        return super().step(action)


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
