"""`robogauntlet policies`: record demonstrations; train, merge, evaluate and serve policies."""

from __future__ import annotations

import typer

from robogauntlet.orchestrator.cli.policies import demonstrate, finetune, merge, pretrain, routing, serve

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)
app.command("demonstrate")(demonstrate.demonstrate)
app.command("pretrain")(pretrain.pretrain)
app.command("finetune")(finetune.finetune)
app.command("merge")(merge.merge)
app.command("routing")(routing.routing)
app.command("serve")(serve.serve)
