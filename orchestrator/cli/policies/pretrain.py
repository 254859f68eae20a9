"""`gauntlet policies pretrain`: train the base that experts start from."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from orchestrator.cli.policies.training import needs_training_packages, run_training

if TYPE_CHECKING:
    from policies.training.finetune import Pace, Trained


def pretrain(
    data: Annotated[list[Path], typer.Argument(metavar="DATA...", help="Datasets, or folders of datasets.")],
    out_folder: Annotated[Path, typer.Option("--out", help="Folder of the checkpoint.")],
    size: Annotated[str, typer.Option(help="tiny, or qwen2.5-0.5b with pretrained weights.")] = "tiny",
    quirks: Annotated[
        list[str] | None,
        typer.Option(
            "--quirk", metavar="NAME", help="Of the paper's released code; 'paper' for all of them. Repeatable."
        ),
    ] = None,
    self_attention: Annotated[
        bool, typer.Option("--self-attention", help="VLA-Adapter's blocks: the paper's negative control.")
    ] = False,
    gate: Annotated[str | None, typer.Option(help="sigmoid or tanh, by default the block's own.")] = None,
    steps: Annotated[int, typer.Option(help="Steps of the optimiser.")] = 2000,
    batch_size: Annotated[int, typer.Option(help="Frames per step.")] = 32,
    learning_rate: Annotated[float, typer.Option(help="After the warm-up.")] = 1e-3,
    schedule: Annotated[str, typer.Option(help="cosine or constant.")] = "cosine",
    action_steps: Annotated[
        int | None, typer.Option(help="Actions of a chunk that the base executes before it looks again; default all.")
    ] = None,
    shift: Annotated[int, typer.Option(help="Images are moved at random by up to so many px.")] = 4,
    seed: Annotated[int, typer.Option(help="Of weights, batches and shifts.")] = 0,
    threads: Annotated[int, typer.Option(help="Threads on the CPU.")] = 1,
) -> None:
    """Train backbone and action expert on the demonstrations of all tasks. Stopped, the same command continues."""
    with needs_training_packages():
        from policies.mergevla.backbone import Pretrained, load_pretrained
        from policies.mergevla.card import check_action_steps
        from policies.mergevla.config import ConvStem
        from policies.training import finetune as training
        from policies.training.options import architecture_of, settings_of
        from policies.training.pool import Pool

    def train(listener: Callable[[Pace], None], stop: Callable[[], bool]) -> Trained:
        architecture = architecture_of(size, quirks or (), self_attention, gate)
        settings = settings_of(steps, batch_size, learning_rate, schedule, shift, seed, threads)
        check_action_steps(action_steps, architecture)
        pool = Pool.open(data)
        pretrained = not isinstance(architecture.vision, ConvStem)
        return training.pretrain(
            pool,
            architecture,
            out_folder,
            settings,
            action_steps=action_steps,
            prepare=(lambda model: load_pretrained(model.backbone, Pretrained())) if pretrained else None,
            listener=listener,
            stop=stop,
        )

    run_training(out_folder, train)
