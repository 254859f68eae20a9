"""`robogauntlet mergevla pretrain`: train the base that experts start from."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from robogauntlet_mergevla.cli.training_progress import needs_training_packages, run_training

if TYPE_CHECKING:
    from robogauntlet_mergevla.training.finetune import TrainingResult, TrainingStatus


def pretrain(
    data: Annotated[list[Path], typer.Argument(metavar="DATA...", help="Datasets, or folders of datasets.")],
    out_folder: Annotated[Path, typer.Option("--out", help="Folder of the checkpoint.")],
    size: Annotated[str, typer.Option(help="tiny, or qwen2.5-0.5b with pretrained weights.")] = "tiny",
    steps: Annotated[int, typer.Option(help="Optimiser steps.")] = 2000,
    batch_size: Annotated[int, typer.Option(help="Frames per step.")] = 32,
    learning_rate: Annotated[float, typer.Option(help="Learning rate after the warm-up.")] = 1e-3,
    schedule: Annotated[str, typer.Option(help="Learning rate schedule: cosine or constant.")] = "cosine",
    action_steps: Annotated[
        int | None,
        typer.Option(help="Actions of a chunk that the base executes before its next query; by default all."),
    ] = None,
    without_actions: Annotated[
        bool,
        typer.Option(
            "--without-actions",
            help="Read no action: train the backbone to match the images of a moment with each other and its sentence.",
        ),
    ] = False,
    shift: Annotated[int, typer.Option(help="Largest random shift of the images (px).")] = 4,
    seed: Annotated[int, typer.Option(help="Seed of weights, batches and shifts.")] = 0,
    threads: Annotated[int, typer.Option(help="CPU threads.")] = 1,
) -> None:
    """Train the base that experts start from.

    Backbone and action expert are trained on the demonstrations of all tasks. With --without-actions, the action
    expert keeps its random weights, as that of the paper's base has. The same command continues a training that was
    stopped.
    """
    with needs_training_packages():
        from robogauntlet_mergevla.checkpoints.metadata import check_action_steps
        from robogauntlet_mergevla.network.backbone import Pretrained, load_pretrained
        from robogauntlet_mergevla.network.config import CONTROLS, SIZES, ArchitectureError, ConvStem
        from robogauntlet_mergevla.training import finetune as training
        from robogauntlet_mergevla.training.batch_loss import Objective
        from robogauntlet_mergevla.training.dataset_mixture import DatasetMixture
        from robogauntlet_mergevla.training.settings import Settings

    def train(listener: Callable[[TrainingStatus], None], stop: Callable[[], bool]) -> TrainingResult:
        known = {**SIZES, **CONTROLS}
        if size not in known:
            raise ArchitectureError(f"expected one of {', '.join(known)} for --size, got '{size}'")
        architecture = known[size]
        settings = Settings.from_json(
            {
                "steps": steps,
                "batch_size": batch_size,
                "learning_rate": learning_rate,
                "schedule": schedule,
                "largest_shift": shift,
                "seed": seed,
                "threads": threads,
            }
        )
        check_action_steps(action_steps, architecture)
        pool = DatasetMixture.open(data)
        pretrained = not isinstance(architecture.vision, ConvStem)
        return training.pretrain(
            pool,
            architecture,
            out_folder,
            settings,
            action_steps=action_steps,
            objective=Objective.MATCHING if without_actions else Objective.L1,
            prepare=(lambda model: load_pretrained(model.backbone, Pretrained())) if pretrained else None,
            listener=listener,
            stop=stop,
        )

    run_training(out_folder, train)
