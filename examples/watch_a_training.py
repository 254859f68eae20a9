"""Evaluate checkpoints while a policy trains: `python examples/watch_a_training.py`.

A plain loop of torch writes a checkpoint now and then, and `robogauntlet watch` beside it plays each one, so that the
loop never waits. It needs `robogauntlet[pybullet]` and torch.
"""

import subprocess
import sys
from pathlib import Path

import numpy as np
import torch
from torch import nn

import robogauntlet

TASK = "pybullet/PandaReach-v3"
SUITE = f"name: reach\nneeds: policy\ntasks: [{TASK}]\nseeds: {{count: 20}}\nworkers: 1\n"
HERE = Path(__file__)


def network() -> nn.Module:
    """From images (n, 96, 96, 3) to the ball's place (n, 3), in metres."""
    layers = [nn.Conv2d(3, 16, 5, 4), nn.ReLU(), nn.Conv2d(16, 32, 5, 3), nn.ReLU(), nn.Flatten(), nn.LazyLinear(3)]
    return nn.Sequential(*layers)


def picture(images: dict[str, np.ndarray]) -> torch.Tensor:
    """The third-person image as the network takes it: (1, 3, 96, 96), from 0 to 1."""
    return torch.tensor(images["third_person"] / 255, dtype=torch.float32).permute(2, 0, 1)[None]


class Policy:
    """What a checkpoint does; `watch` gives its folder."""

    def __init__(self, checkpoint: str) -> None:
        self.network = network()
        self.network.load_state_dict(torch.load(Path(checkpoint) / "weights.pt", weights_only=True))

    def __call__(self, images: dict[str, np.ndarray], proprioception: np.ndarray, instruction: str) -> np.ndarray:
        """Move the tool to where the ball seems to be, eight actions at a time."""
        with torch.no_grad():
            way = self.network(picture(images))[0].numpy() - proprioception[:3]
        return np.tile([*way / 8, 0, 0, 0, 1], (8, 1))


def train(folder: Path, steps: int, every: int, scenes: int) -> None:
    """Regress the ball's place from first images of seeds that the suite does not have."""
    environment = robogauntlet.make(TASK)
    seen, places = [], []
    for number in range(scenes):
        observation, _ = environment.reset(seed=10_000 + number)
        seen.append(picture(observation["images"]))
        places.append(environment.simulation.privileged_state()["goal_position"])
    inputs, targets = torch.cat(seen), torch.tensor(np.array(places), dtype=torch.float32)
    model = network()
    model(inputs[:1])  # sizes its last layer
    optimiser = torch.optim.Adam(model.parameters(), 1e-3)
    for step in range(1, steps + 1):
        batch = torch.randint(len(inputs), (32,))
        loss = nn.functional.l1_loss(model(inputs[batch]), targets[batch])
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        if step % every == 0:
            checkpoint = folder / f"checkpoint-{step}"
            checkpoint.mkdir(parents=True, exist_ok=True)
            torch.save(model.state_dict(), checkpoint / "weights.pt")
    environment.close()


if __name__ == "__main__":
    Path("reach.yaml").write_text(SUITE)
    Path("training").mkdir(exist_ok=True)
    kind = ["--policy-kind", f"python:{HERE.stem}:Policy", "--option", f"folder={HERE.parent}"]
    watch = subprocess.Popen(["robogauntlet", "watch", "training", "--suite", "reach.yaml", *kind, "--until", "3"])
    train(Path("training"), steps=1200, every=400, scenes=200)
    sys.exit(watch.wait())
