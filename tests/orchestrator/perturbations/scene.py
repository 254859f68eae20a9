"""The null simulator with images and scene controls, for tests that take milliseconds."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.camera_geometry import looking_at
from robogauntlet.adapters.catalog import open_simulation
from robogauntlet.adapters.frames import hash_state
from robogauntlet.adapters.photometry import encoded, linear
from robogauntlet.adapters.scene_control import (
    DynamicsFactors,
    Light,
    PlacementRegion,
    SceneControls,
    Unreachable,
    unit,
)
from robogauntlet.orchestrator.perturbations import perturbed
from robogauntlet.orchestrator.perturbations.table_and_distractors import discs_of
from robogauntlet.suites.episode import Condition, Episode, Protocol, View

TABLE = (slice(40, 90), slice(10, 90))
"""Rows and columns of the table in every image."""


class Scene:
    """Records actions and changes. It is its own scene control for everything."""

    arm = (slice(0, 0), slice(0, 0))
    """Rows and columns of the arm in every image, which hides props."""
    drift = 1
    """Difference between consecutive images, in one corner."""
    table_height = 0.0
    table_edges = np.array([[-0.2, -0.4], [1.0, 0.4]])

    def __init__(self):
        self.inner = open_simulation("null/Reach", View())
        self.action_spec, self.observation_spec = self.inner.action_spec, self.inner.observation_spec
        self.scene_controls = SceneControls(*[self] * 7)
        self.executed, self.frames = [], 0
        aim = np.array([0.5, 0.0, 0.0])
        self.viewpoints = {
            "third_person": looking_at(aim + 0.6, aim, 0.7),
            "wrist": looking_at(np.array([0.05, 0.0, 0.0]), np.array([0.05, 0.0, 1.0]), 1.2, np.array([1.0, 0, 0])),
        }
        self.now = Light(np.ones(3), unit(np.array([0.5, 0.3, 0.8])))
        self.texture, self.props, self.factors = None, (), DynamicsFactors()
        self.tool = np.array([0.45, 0.0, 0.2]), np.array([1.0, 0.0, 0.0, 0.0])
        self.things = {"cube": np.array([0.5, 0.05, 0.02]), "other": np.array([0.5, -0.04, 0.02])}

    def observe(self):
        seen = self.inner.observe()
        self.frames += 1
        return replace(seen, images={camera: self._image(camera) for camera in seen.images})

    def _image(self, camera):
        """Of the viewpoint only the props depend, because cameras are measured by what is read back."""
        image = np.full((96, 96, 3), 90, np.uint8)
        image[TABLE] = (130, 120, 110)
        if self.texture is not None:
            n = len(self.texture)
            rows, columns = np.indices((50, 80))
            image[TABLE] = encoded(0.8 * linear(self.texture[rows * n // 50, columns * n // 80]))
        image[20:30, 20:60] = (200, 30, self.drift * self.frames % 40 + 40)
        discs = discs_of(self.viewpoints[camera], self.props, 96) if self.props else ()
        for (column, row, radius, _), prop in sorted(zip(discs, self.props, strict=True), key=lambda one: -one[0][3]):
            rows, columns = np.indices((96, 96))
            image[(columns - column) ** 2 + (rows - row) ** 2 <= radius**2] = 255 * np.array(prop.colour)
        image[self.arm] = 20
        lit = np.clip(encoded(linear(image) * self.now.gain * (0.5 + 0.5 * self.now.direction[2])), 0, 255)
        lit[:8] = 255  # a sky that no lamp illuminates
        return np.rint(lit).astype(np.uint8)

    def step(self, action):
        self.executed.append(np.array(action))
        return self.inner.step(action)

    def privileged_state(self):
        position, quaternion = self.tool
        own = {"tcp_position": position, "tcp_quaternion": quaternion}
        return dict(self.inner.privileged_state()) | own | {f"{n}_position": p.copy() for n, p in self.things.items()}

    def state_hash(self):
        return self.inner.state_hash() + hash_state({"tool": np.concatenate(self.tool), **self.things})

    def viewpoint(self, camera):
        return self.viewpoints[camera]

    def set_viewpoint(self, camera, viewpoint):
        self.viewpoints[camera] = viewpoint

    def light(self):
        return self.now

    def set_light(self, light):
        self.now = light

    def placeable(self):
        return {"cube": PlacementRegion(np.array([0.4, -0.1]), np.array([0.6, 0.1]))}

    def move(self, name, offset):
        self.things[name][:2] += offset

    def resample(self, seed):
        self.things["cube"] = np.array([0.5 + 0.03, 0.05 + 0.04, 0.02])

    def place_tool(self, position, quaternion):
        if position[0] > 0.5:
            raise Unreachable("too far")
        self.tool = position, Rotation.from_quat(quaternion).as_quat()

    def dynamics(self):
        return self.factors

    def set_dynamics(self, dynamics):
        self.factors = dynamics

    def show(self, props):
        self.props = tuple(props)

    def shown(self):
        return [prop.position for prop in self.props]

    def paint_table(self, texture):
        self.texture = texture

    def __getattr__(self, name):
        return getattr(self.inner, name)


class TwoArms(Scene):
    """The same with a second arm, which does nothing."""

    def __init__(self):
        super().__init__()
        self.action_spec = replace(self.action_spec, ignored=(), arms=2)

    def step(self, action):
        self.executed.append(np.array(action))
        return self.inner.step(action[:7])

    def privileged_state(self):
        second = {"tcp_position": [0.45, 0.1, 0.2], "base_position": [1.1, 0.0, 0.0]}
        return super().privileged_state() | {f"second_{name}": np.array(place) for name, place in second.items()}


def episode(axis="clean", severity=0, policy="p", seed=4):
    """An episode of the null simulator's task."""
    return Episode(policy, policy, "null/Reach", seed, Protocol(40), Condition(axis, severity))


def begin(axis, severity, *, scene=None, **which):
    """A scene, and its perturbed simulation after the reset."""
    scene = scene or Scene()
    simulation = perturbed(scene, episode(axis, severity, **which))
    simulation.reset(4)
    return scene, simulation
