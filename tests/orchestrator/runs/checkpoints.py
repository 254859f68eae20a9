"""Checkpoints of a training run that became worse: policies whose rate of success in `null/Reach` is known."""

MODULE = """
import numpy as np

GOALS = {{}}
for seed in range({seeds}):
    generator = np.random.default_rng([seed, 0])
    start = generator.uniform(-0.5, 0.5, 3)
    GOALS[tuple(start.round(9))] = seed, generator.uniform(-0.5, 0.5, 3)


class Checkpoint:
    rate = 1.0

    def reset(self):
        self.goal = None

    def __call__(self, images, proprioception, instruction):
        position = proprioception[:3]
        if self.goal is None:
            seed, goal = GOALS[tuple(position.round(9))]
            self.goal = goal if np.random.default_rng([seed, 5]).random() < self.rate else position
        chunk = np.zeros((1, 7))
        chunk[0, :3] = np.clip(self.goal - position, -0.05, 0.05)
        return chunk
"""


def write_checkpoints(folder, rates, *, seeds=100):
    """Write the module `steps`, and return the texts that name its checkpoints, one for each rate."""
    text = MODULE.format(seeds=seeds)
    for number, rate in enumerate(rates):
        text += f"\n\nclass Step{number}(Checkpoint):\n    rate = {rate}\n"
    (folder / "steps.py").write_text(text)
    return [f"python:steps:Step{number}" for number in range(len(rates))]
