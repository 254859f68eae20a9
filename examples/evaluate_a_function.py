"""Evaluate a function, and look at one of its episodes: `python examples/evaluate_a_function.py`.

The cells between `# %%` can be run one by one in an editor or a notebook.
"""

# %%
import numpy as np

import robogauntlet

TASK = "pybullet/PandaReach-v3"


# %% A policy, from pixels alone. The camera was measured in 150 pictures of other seeds.
def act(images: dict[str, np.ndarray], proprioception: np.ndarray, instruction: str) -> np.ndarray:
    """Move the tool to the red ball, four actions at a time."""
    camera = np.array([1.2529, 0.3445, 0.505])  # place (m), right, below, ahead
    axes = np.array([[-0.0148, 0.0311, 0.0004], [0.0141, 0.0073, -0.0305], [-0.0402, -0.0205, -0.0229]])
    tool, picture = proprioception[:3], images["third_person"].astype(float)
    red = picture[..., 0] - picture[..., 1:].max(axis=2) > 60
    if red.sum() < 10:  # hidden
        step = 0.03 * (tool - camera) / np.linalg.norm(tool - camera)
    else:
        down, right = np.argwhere(red).mean(axis=0) / len(red) - 0.5
        step = (camera + np.array([right, down, 1]) @ axes / np.sqrt(red.mean()) - tool) / 6
    return np.tile([*step, 0, 0, 0, 1], (4, 1))  # metres, radians, gripper from -1 (open) to +1 (closed)


# %% Its success, clean and with noisy images.
run = robogauntlet.evaluate(act, TASK, seeds=4, conditions="noise@2")
print(run)

# %% A row per episode.
print(run.episodes()[["axis", "seed", "status", "steps"]].to_string(index=False))

# %% Its first episode, step by step.
environment = robogauntlet.make(TASK, render_mode="rgb_array")
observation, _ = environment.reset(seed=0)
print(observation["instruction"])
for action in act(**observation):
    observation, reward, terminated, truncated, info = environment.step(action)
print(observation["proprioception"][:3].round(3), info, environment.render().shape)
environment.close()
