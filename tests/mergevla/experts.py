"""Tiny experts of one base, with the weights that fine-tuning changes."""

from functools import cache

import torch

from robogauntlet_mergevla.checkpoints.expert_checkpoint import load_checkpoint, load_folded, save_checkpoint
from robogauntlet_mergevla.checkpoints.merge_experts import merge_experts, read_experts
from robogauntlet_mergevla.checkpoints.metadata import CheckpointMetadata
from robogauntlet_mergevla.merging.recipe import Recipe
from robogauntlet_mergevla.network.config import LoraSettings
from robogauntlet_mergevla.network.lora import add_lora
from robogauntlet_mergevla.network.model import build
from tests.mergevla.shared import SMALL, task_statistics

TASKS = ("null/Reach", "null/Slow", "null/Raise")
INSTRUCTIONS = {"null/Reach": "reach", "null/Slow": "wait", "null/Raise": "look"}
RANK = 2


def save_base(folder, seed=0, architecture=SMALL, dtype=torch.float32):
    metadata = CheckpointMetadata(architecture, task_statistics(task="null/All"))
    save_checkpoint(folder, build(architecture, seed).to(dtype), metadata)
    return folder


def save_expert(
    folder, base, task, seed, *, rank=RANK, convolutions=False, tune_all=False, action_steps=None, several=()
):
    """An expert of `task`, or of several tasks under that name, whose every trainable weight was moved at random."""
    model = load_checkpoint(base).model
    lora = LoraSettings(rank, convolutions)
    add_lora(model, lora, seed)
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for parameter in model.parameters():
            if parameter.requires_grad or tune_all:
                parameter += 0.05 * torch.randn(parameter.shape, generator=generator)
    metadata = CheckpointMetadata(
        model.architecture, task_statistics(seed, task), tuple(several), action_steps=action_steps, lora=lora
    )
    save_checkpoint(folder, model, metadata, base=base)
    return folder


def save_experts(folder, tasks=TASKS, architecture=SMALL):
    """A base in `folder/base`, and an expert for each task in `folder/experts`."""
    base = save_base(folder / "base", architecture=architecture)
    return [
        save_expert(folder / "experts" / task.replace("/", "-"), base, task, seed)
        for seed, task in enumerate(tasks, start=1)
    ]


def merging(folders, recipe=None, instructions=INSTRUCTIONS, **changes):
    cards = tuple((folder, (folder / "card.json").read_bytes()) for folder in folders)
    return merge_experts(_experts(cards), recipe or Recipe.from_json(changes), instructions)


@cache
def _experts(cards):
    return read_experts([folder for folder, _ in cards])


def plain(folder):
    """An expert's network without adapters."""
    return load_folded(folder).model
