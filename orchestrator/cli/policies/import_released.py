"""`robogauntlet policies import`: make a checkpoint from a released one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from robogauntlet.orchestrator.cli.common import print_line
from robogauntlet.support.errors import BadInput, describe_os_error_at
from robogauntlet_mergevla.checkpoints.metadata import WEIGHTS
from robogauntlet_mergevla.cli.training_progress import needs_training_packages
from robogauntlet_mergevla.released.names import Kind


def import_released(
    kind: Annotated[Kind, typer.Argument(metavar="KIND", help="mergevla, vla-adapter or prismatic.")],
    files: Annotated[
        list[Path], typer.Argument(metavar="FILES...", help="Files of the released checkpoint, or folders of them.")
    ],
    out_folder: Annotated[Path, typer.Option("--out", help="Folder of the checkpoint.")],
    tokenizer: Annotated[
        str | None,
        typer.Option(
            help="Folder or hub id of the tokenizer, or words, for hashed words; by default Qwen/Qwen2.5-0.5B.",
            show_default=False,
        ),
    ] = None,
    seed: Annotated[
        int, typer.Option(min=0, max=2**63 - 1, help="Seed of the new action expert of a prismatic base.")
    ] = 0,
) -> None:
    """Make a checkpoint from a released one of MergeVLA, VLA-Adapter-Pro or Prismatic.

    Weights are read by their names, of the size qwen2.5-0.5b; nothing is downloaded.
    """
    with needs_training_packages():
        from robogauntlet_mergevla.released.importing import import_released as read
        from robogauntlet_mergevla.released.importing import save_imported
    try:
        if out_folder.exists() and not (out_folder.is_dir() and not any(out_folder.iterdir())):
            raise BadInput(f"expected a new folder for --out, got '{out_folder}'")
        metadata = save_imported(read(kind, files, seed=seed, tokenizer=tokenizer), out_folder)
    except OSError as error:
        raise BadInput(describe_os_error_at(error, out_folder)) from None
    size = (out_folder / WEIGHTS).stat().st_size / 1e6
    print_line(f"{out_folder}: {metadata.architecture.name} from {kind}, {size:,.1f} MB")
