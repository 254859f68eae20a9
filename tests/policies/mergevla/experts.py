"""Tiny experts of one base, as fine-tuning would have left them."""

from pathlib import Path

import torch

from policies.mergevla.card import Card
from policies.mergevla.checkpoint import load_checkpoint, save_checkpoint
from policies.mergevla.config import LoraSettings
from policies.mergevla.lora import add_lora, folded
from policies.mergevla.merging.recipe import Recipe
from policies.mergevla.merging_experts import merge_experts, read_experts
from tests.policies.mergevla.shared import SMALL, small_model, task_statistics

TASKS = ("null/Reach", "null/Slow", "null/Missing")
INSTRUCTIONS = {"null/Reach": "reach", "null/Slow": "wait", "null/Missing": "look"}
RANK = 2


def save_base(folder: Path, seed=0) -> Path:
    save_checkpoint(folder, small_model(seed), Card(SMALL, task_statistics(task="null/All")))
    return folder


def save_expert(folder: Path, base: Path, task: str, seed: int, *, size=0.05, rank=RANK) -> Path:
    """An expert whose every trainable weight was moved at random."""
    model = load_checkpoint(base).model
    lora = LoraSettings(rank)
    add_lora(model, lora, seed)
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for parameter in model.parameters():
            if parameter.requires_grad:
                parameter += size * torch.randn(parameter.shape, generator=generator)
    save_checkpoint(folder, model, Card(SMALL, task_statistics(seed, task), lora=lora), base=base)
    return folder


def save_experts(folder: Path, tasks=TASKS) -> list[Path]:
    """A base in `folder/base`, and an expert for each task beside it in `folder/experts`."""
    base = save_base(folder / "base")
    return [
        save_expert(folder / "experts" / task.replace("/", "-"), base, task, seed)
        for seed, task in enumerate(tasks, start=1)
    ]


def merging(folders, recipe=None, **changes):
    return merge_experts(read_experts(folders), recipe or Recipe(**changes), INSTRUCTIONS)


def plain(folder):
    """An expert's network without adapters."""
    return folded(load_checkpoint(folder).model)
