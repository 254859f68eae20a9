"""`robogauntlet policies`: create, check, train, merge, evaluate and serve policies."""

from __future__ import annotations

import typer

from robogauntlet.orchestrator.cli.policies import check, demonstrate, new, serve
from robogauntlet_mergevla.cli import finetune, merge, pretrain, routing

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)
app.command("new")(new.new)
app.command("check")(check.check)
app.command("demonstrate")(demonstrate.demonstrate)
app.command("pretrain")(pretrain.pretrain)
app.command("finetune")(finetune.finetune)
app.command("merge")(merge.merge)
app.command("routing")(routing.routing)
app.command("serve")(serve.serve)
