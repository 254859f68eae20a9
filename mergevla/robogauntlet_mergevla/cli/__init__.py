"""`robogauntlet mergevla`: train experts, merge them, and evaluate their routers."""

from __future__ import annotations

import typer

from robogauntlet_mergevla.cli import finetune, merge, pretrain, routing

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)
app.command("pretrain")(pretrain.pretrain)
app.command("finetune")(finetune.finetune)
app.command("merge")(merge.merge)
app.command("routing")(routing.routing)
