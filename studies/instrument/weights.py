"""Experts with noise on their weights, as checkpoints: `python -m studies.instrument.weights SIZE FOLDER`."""

import sys
from pathlib import Path

import torch

from robogauntlet_mergevla.checkpoints.expert_checkpoint import load_checkpoint, save_checkpoint
from robogauntlet_mergevla.options import expert_folders
from robogauntlet_mergevla.zoo import shipped


def write(size: float, folder: Path) -> None:
    """Write every expert with Gaussian noise on each tensor, of a deviation that is `size` times its root mean square.

    A size gives the same noise, scaled, as any other.
    """
    generator = torch.Generator().manual_seed(0)
    for path in sorted(expert_folders(shipped("zoo:experts")).values()):
        checkpoint = load_checkpoint(path)
        with torch.no_grad():
            for tensor in checkpoint.model.state_dict().values():
                if tensor.is_floating_point():
                    noise = torch.randn(tensor.shape, generator=generator).to(tensor.dtype)
                    tensor += size * tensor.square().mean().sqrt() * noise
        save_checkpoint(folder / path.name, checkpoint.model, checkpoint.metadata, shipped("zoo:base"))


if __name__ == "__main__":
    write(float(sys.argv[1]), Path(sys.argv[2]))
