"""The adapters' control step beside MuJoCo's own physics steps and robosuite's own control step, in one process.

LIBERO's figures are printed where LIBERO is installed: by the Python of `robogauntlet env create libero`.
"""

import time
from collections.abc import Callable
from statistics import median

import numpy as np

from robogauntlet.adapters.libero.assets import package_folder
from robogauntlet.adapters.mujoco_parts.simulation import MujocoSimulation
from robogauntlet.suites.episode import RenderProfile, View
from studies.percent import few
from studies.shared import open_task, table_of

ROBOSUITE = ("robosuite/Lift", "robosuite/Stack", "robosuite/Door")
LIBERO = (
    "libero/object-0-alphabet-soup",
    "libero/goal-7-turn-on-stove",
    "libero/spatial-4-in-top-drawer-wooden-cabinet",
)
SEEDS, STEPS, HELD = 4, 40, 8


def measure() -> list[dict[str, object]]:
    """Processor time of one control step (ms): medians over equal states and actions, which are held for a while."""
    rows: list[dict[str, object]] = []
    for task in LIBERO if package_folder() else ROBOSUITE:
        simulation = open_task(task, View(render_profile=RenderProfile.FAST))
        assert isinstance(simulation, MujocoSimulation)
        mujoco, model, data, env = simulation._mujoco, simulation._model, simulation._data, simulation._env
        alone, high, state = mujoco.MjData(model), simulation.action_spec.high, mujoco.mjtState.mjSTATE_INTEGRATION
        before = np.empty(mujoco.mj_stateSize(model, state))
        physics_steps = int(env.control_timestep / env.model_timestep)
        times: dict[str, list[float]] = {"mujoco": [], "robosuite": [], "own": []}
        for seed in range(few(SEEDS)):
            simulation.reset(seed)
            shares = np.random.default_rng(seed).uniform(-1.0, 1.0, (STEPS // HELD, 7)).repeat(HELD, axis=0)
            for share in shares:
                mujoco.mj_getState(model, data, before, state)
                mujoco.mj_setState(model, alone, before, state)
                times["mujoco"].append(cost(mujoco.mj_step, model, alone, nstep=physics_steps))
                times["robosuite"].append(cost(env.step, share))
                mujoco.mj_setState(model, data, before, state)
                times["own"].append(cost(simulation.step, share * high))
        simulation.close()
        spent = {name: 1000.0 * median(values) for name, values in times.items()}
        rows.append({"task": task, "ratio": spent["own"] / spent["mujoco"], **spent})
        rows[-1]["faster"] = spent["robosuite"] / spent["own"]
    columns = {"task": "{task}", "MuJoCo's 25 steps, ms": "{mujoco:.2f}", "control step, ms": "{own:.2f}"}
    columns |= {"ratio": "{ratio:.2f}", "robosuite's own step, ms": "{robosuite:.2f}", "times as fast": "{faster:.1f}"}
    table_of(rows, columns)
    return rows


def cost(run: Callable[..., object], *arguments: object, **options: object) -> float:
    """Processor time of a call (s)."""
    start = time.process_time()
    run(*arguments, **options)
    return time.process_time() - start
