"""A worker's rollout against a bare loop on the simulator's own API, with the same frames, actions and seeds."""

import time
from collections.abc import Callable, Sequence
from statistics import median
from typing import Any

import numpy as np

from robogauntlet.adapters.contract import FloatArray, Simulation
from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.policies.contract import Decision, PolicyInput, PolicySpec, Query, StatelessPolicy
from robogauntlet.suites.episode import View
from studies.percent import few
from studies.shared import TASKS, episodes, open_task, table_of

PAIRS = 12
STEPS, CHUNK = 40, 8


class Fixed(StatelessPolicy):
    """Observes, and answers with a fixed chunk at no cost."""

    spec = PolicySpec(PolicyInput.OBSERVATION, CHUNK)

    def __init__(self, chunk: FloatArray) -> None:
        self.chunk = chunk

    def act(self, queries: Sequence[Query]) -> Sequence[Decision]:
        """The chunk."""
        return [Decision(self.chunk) for _ in queries]


def bare_maniskill(simulation: Any) -> Callable[[int, FloatArray], None]:
    """Reset, observe and step as ManiSkill's documentation does."""
    import torch

    env = simulation._env
    cameras = [env.scene.sensors[name] for name in ("base_camera", "hand_camera")]

    def play(seed: int, chunk: FloatArray) -> None:
        env.reset(seed=seed)
        commands = torch.as_tensor(chunk, dtype=torch.float32)
        for step in range(STEPS):
            if step % CHUNK == 0:
                env.scene.update_render()
                for camera in cameras:
                    camera.capture()
                    camera.get_obs(rgb=True, depth=False, position=False, segmentation=False)["rgb"].numpy()
            env.step(commands[step % CHUNK])

    return play


def bare_pybullet(simulation: Any) -> Callable[[int, FloatArray], None]:
    """Reset, observe and step through panda-gym's robot and PyBullet's client, without panda-gym's observations."""
    env, client = simulation._env, simulation._client

    def frame() -> None:
        _, _, pixels, _, _ = client.getCameraImage(
            96,
            96,
            client.computeViewMatrix((0.7, 0.4, 0.5), (0, 0, 0.1), (0, 0, 1)),
            client.computeProjectionMatrixFOV(40, 1, 0.01, 10),
            shadow=True,
            renderer=client.ER_TINY_RENDERER,
        )
        np.asarray(pixels, np.uint8).reshape(96, 96, 4)[..., :3].copy()

    def play(seed: int, chunk: FloatArray) -> None:
        env.reset(seed=seed)
        for step in range(STEPS):
            if step % CHUNK == 0:
                frame()
                frame()
            env.robot.set_action(chunk[step % CHUNK][:3])
            env.sim.step()
            env.task.is_success(env.task.get_achieved_goal(), env.task.get_goal())

    return play


def bare_robosuite(simulation: Any) -> Callable[[int, FloatArray], None]:
    """Reset, observe and step as robosuite's and MuJoCo's documentation do."""
    env, data = simulation._env, simulation._data
    renderer = simulation._scene._create_renderer(96)

    def play(seed: int, chunk: FloatArray) -> None:
        env.rng = np.random.default_rng(seed)
        env.reset()
        for step in range(STEPS):
            if step % CHUNK == 0:
                for camera in ("agentview", "robot0_eye_in_hand"):
                    renderer.update_scene(data, camera)
                    renderer.render()
            env.step(chunk[step % CHUNK])

    return play


BARE: dict[str, Callable[[Simulation], Callable[[int, FloatArray], None]]] = {
    "maniskill": bare_maniskill,
    "pybullet": bare_pybullet,
    "robosuite": bare_robosuite,
}


def measure() -> list[dict[str, object]]:
    """Seconds per episode of both, alternating in the same simulation; the ratio is the median over pairs."""
    rows = []
    for task in TASKS:
        view = View()
        simulation = open_task(task, view)
        simulation.culling = False  # type: ignore[attr-defined]  # The bare loop draws everything.
        chunk = np.random.default_rng(0).uniform(-0.2, 0.2, (CHUNK, 7))
        ours = chunk * simulation.action_spec.high
        bare, policy = BARE[task.partition("/")[0]](simulation), Fixed(ours)
        times: list[tuple[float, float]] = []
        for episode in episodes(task, "fixed", view, few(PAIRS) + 1, horizon=STEPS):
            start = time.perf_counter()
            result = rollout(simulation, policy, episode)
            middle = time.perf_counter()
            bare(episode.seed, chunk)
            times.append((middle - start, time.perf_counter() - middle))
            assert result.steps == STEPS
        simulation.close()
        worker, plain = (median(pair[i] for pair in times[1:]) for i in (0, 1))
        ratio = median(a / b for a, b in times[1:])
        rows.append({"task": task, "rollout_s": worker, "bare_s": plain, "ratio": ratio})
    columns = {"task": "{task}", "rollout, s/episode": "{rollout_s:.3f}", "bare loop, s/episode": "{bare_s:.3f}"}
    table_of(rows, columns | {"ratio (median of pairs)": "{ratio:.3f}"})
    return rows
