"""`gauntlet policies finetune`: train an expert for one task."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from orchestrator.cli.policies.training import needs_training_packages, run_training

if TYPE_CHECKING:
    from policies.training.finetune import Pace, Trained


def finetune(
    data: Annotated[
        list[Path], typer.Argument(metavar="DATA...", help="Datasets of the task, each with the same share of a batch.")
    ],
    base: Annotated[str, typer.Option(help="Checkpoint to start from: a folder or a hub id.")],
    out_folder: Annotated[Path, typer.Option("--out", help="Folder of the checkpoint.")],
    steps: Annotated[int, typer.Option(help="Steps of the optimiser.")] = 2000,
    batch_size: Annotated[int, typer.Option(help="Frames per step.")] = 32,
    learning_rate: Annotated[float, typer.Option(help="After the warm-up.")] = 5e-4,
    schedule: Annotated[str, typer.Option(help="cosine or constant.")] = "cosine",
    rank: Annotated[int, typer.Option(help="Of the adapters on the backbone (LoRA).")] = 32,
    adapt_convolutions: Annotated[bool, typer.Option(help="Adapters on convolutions too.")] = False,
    action_steps: Annotated[
        int | None, typer.Option(help="Actions of a chunk that the expert executes before it looks again; default all.")
    ] = None,
    shift: Annotated[int, typer.Option(help="Images are moved at random by up to so many px.")] = 4,
    seed: Annotated[int, typer.Option(help="Of adapters, batches and shifts.")] = 0,
    threads: Annotated[int, typer.Option(help="Threads on the CPU.")] = 1,
) -> None:
    """Train an expert: adapters on the base's backbone, all of its action expert. Stopped, the same command continues.

    The expert's checkpoint holds only what differs from the base, which must stay where it is.
    """
    with needs_training_packages():
        from policies.mergevla.card import check_action_steps, locate, read_card
        from policies.mergevla.config import LoraSettings
        from policies.training import finetune as training
        from policies.training.options import settings_of
        from policies.training.pool import Pool

    def train(listener: Callable[[Pace], None], stop: Callable[[], bool]) -> Trained:
        settings = settings_of(steps, batch_size, learning_rate, schedule, shift, seed, threads)
        lora = LoraSettings(rank, adapt_convolutions)
        start = Path(base) if Path(base).exists() else base
        # Decoding the data takes minutes, a mistyped base or number should not.
        check_action_steps(action_steps, read_card(locate(base)).architecture)
        pool = Pool.open(data)
        return training.finetune(
            pool, start, out_folder, settings, lora=lora, action_steps=action_steps, listener=listener, stop=stop
        )

    run_training(out_folder, train)
