"""`robogauntlet mergevla finetune`: train an expert for one task or several."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from robogauntlet_mergevla.cli.training_progress import needs_training_packages, run_training

if TYPE_CHECKING:
    from robogauntlet_mergevla.training.finetune import TrainingResult, TrainingStatus


def finetune(
    data: Annotated[
        list[Path], typer.Argument(metavar="DATA...", help="Datasets of its tasks. Each has the same share of a batch.")
    ],
    base: Annotated[str, typer.Option(help="Checkpoint to start from: a folder, zoo:NAME or a hub id.")],
    out_folder: Annotated[Path, typer.Option("--out", help="Folder of the checkpoint.")],
    steps: Annotated[int, typer.Option(help="Optimiser steps.")] = 2000,
    batch_size: Annotated[int, typer.Option(help="Frames per step.")] = 32,
    learning_rate: Annotated[float, typer.Option(help="Learning rate after the warm-up.")] = 5e-4,
    schedule: Annotated[str, typer.Option(help="Learning rate schedule: cosine or constant.")] = "cosine",
    rank: Annotated[int, typer.Option(help="Rank of the LoRA adapters on the backbone.")] = 32,
    adapt_convolutions: Annotated[bool, typer.Option(help="Also adapt convolutions.")] = False,
    action_steps: Annotated[
        int | None,
        typer.Option(help="Actions of a chunk that the expert executes before its next query; by default all."),
    ] = None,
    fresh_trunk: Annotated[
        int | None,
        typer.Option(
            min=0,
            metavar="SEED",
            help="Initialise the action expert from this seed instead of continuing the base's.",
            show_default=False,
        ),
    ] = None,
    bfloat16: Annotated[
        bool, typer.Option("--bfloat16", help="Store the weights in bfloat16, half the size of fp32.")
    ] = False,
    shift: Annotated[int, typer.Option(help="Largest random shift of the images (px).")] = 4,
    change_words: Annotated[
        float, typer.Option(help="Share of the instruction's words to leave out, replace or follow by another.")
    ] = 0.0,
    seed: Annotated[int, typer.Option(help="Seed of adapters, batches, shifts and words.")] = 0,
    threads: Annotated[int, typer.Option(help="CPU threads.")] = 1,
) -> None:
    """Train an expert for one task, or for several, under the name of its folder.

    LoRA adapters on the backbone of the base are trained, and all of its action expert, or a new one (--fresh-trunk).
    The checkpoint stores only the difference to the base, which must stay where it is. The same command continues a
    training that was stopped.
    """
    with needs_training_packages():
        import torch

        from robogauntlet_mergevla.checkpoints.metadata import CheckpointMetadata, check_action_steps, locate
        from robogauntlet_mergevla.network.config import LoraSettings
        from robogauntlet_mergevla.training import finetune as training
        from robogauntlet_mergevla.training.dataset_mixture import DatasetMixture
        from robogauntlet_mergevla.training.settings import Settings

    def train(listener: Callable[[TrainingStatus], None], stop: Callable[[], bool]) -> TrainingResult:
        settings = Settings.from_json(
            {
                "steps": steps,
                "batch_size": batch_size,
                "learning_rate": learning_rate,
                "schedule": schedule,
                "largest_shift": shift,
                "changed_words": change_words,
                "seed": seed,
                "threads": threads,
            }
        )
        lora = LoraSettings(rank, adapt_convolutions)
        start = Path(base) if Path(base).exists() else base
        # Checked first, since decoding the data takes minutes.
        check_action_steps(action_steps, CheckpointMetadata.read(locate(base)).architecture)
        pool = DatasetMixture.open(data)
        return training.finetune(
            pool,
            start,
            out_folder,
            settings,
            lora=lora,
            action_steps=action_steps,
            fresh_trunk=fresh_trunk,
            dtype=torch.bfloat16 if bfloat16 else None,
            listener=listener,
            stop=stop,
        )

    run_training(out_folder, train)
