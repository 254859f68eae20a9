"""`robogauntlet adapters`: list, create and check simulator adapters."""

from __future__ import annotations

import typer

from robogauntlet.orchestrator.cli.adapters import check, list, new

app = typer.Typer(no_args_is_help=True)
app.command("list")(list.list_adapters)
app.command("check")(check.check)
app.command("new")(new.new)
