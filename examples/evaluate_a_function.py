"""Evaluate a function, and look at one of its episodes: `python examples/evaluate_a_function.py`.

The cells between `# %%` can be run one by one in an editor or a notebook.
"""

# %%
import numpy as np

import robogauntlet

TASK = "pybullet/PandaReach-v3"


# %% A policy: eight actions towards the middle of the table. Metres, radians, gripper from -1 (open) to +1 (closed).
def towards_the_middle(images: dict[str, np.ndarray], proprioception: np.ndarray, instruction: str) -> np.ndarray:
    """Return eight actions, (8, 7)."""
    way = np.array([0.6, 0.0, 0.15]) - proprioception[:3]
    return np.tile([*np.clip(way / 8, -0.03, 0.03), 0.0, 0.0, 0.0, 1.0], (8, 1))


# %% Its success, clean and with noisy images.
run = robogauntlet.evaluate(towards_the_middle, TASK, seeds=4, conditions="noise@2")
print(run)

# %% A row per episode.
print(run.episodes()[["axis", "seed", "status", "steps"]].to_string(index=False))

# %% Its first episode, step by step.
environment = robogauntlet.make(TASK, render_mode="rgb_array")
observation, _ = environment.reset(seed=0)
print(observation["instruction"])
for action in towards_the_middle(**observation):
    observation, reward, terminated, truncated, info = environment.step(action)
print(observation["proprioception"][:3].round(3), info, environment.render().shape)
environment.close()
