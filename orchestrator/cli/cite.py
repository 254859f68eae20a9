"""`robogauntlet cite`: BibTeX for a paper."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer

import robogauntlet
from robogauntlet.adapters import catalog
from robogauntlet.results.report.formatting import escape_latex
from robogauntlet.results.run_document import RunDocument, read_run

YEAR = 2026
"""Of the version that CITATION.cff names."""


def cite(folder: Annotated[Path | None, typer.Argument(metavar="[RUN]", help="Run folder.")] = None) -> None:
    """Print BibTeX of RoboGauntlet, and of the simulators of a run.

    With a run, the version is that which played it, and a note has its suite, the hash of its suite and that of its
    rows.
    """
    document = None if folder is None else read_run(folder)
    entries = [_tool(document), *(() if document is None else _simulators(document))]
    typer.echo("\n\n".join(dict.fromkeys(entries)))


def _tool(document: RunDocument | None) -> str:
    version = robogauntlet.__version__
    fields = {
        "title": "{RoboGauntlet}: Reproducible, statistically sound evaluation of robot policies across simulators",
        "author": "{RoboGauntlet contributors}",
        "year": str(YEAR),
        "version": version,
    }
    if document is not None:
        fields["version"] = document.provenance.packages.get("robogauntlet", version)
        rows = document.rows_hash or "not computed"
        fields["note"] = (
            f"Suite {escape_latex(document.suite.name)}, suite hash {document.suite_hash}, rows hash {rows}"
        )
    lines = ",\n".join(f"  {name} = {{{value}}}" for name, value in fields.items())
    return f"@software{{robogauntlet,\n{lines}\n}}"


def _simulators(document: RunDocument) -> Iterator[str]:
    """The entries that the adapters of a run declare, in the order of its plan."""
    for name in dict.fromkeys(cell.simulator for cell in document.plan):
        adapter = catalog.simulators().get(name)
        if name in document.skipped or (adapter is not None and adapter.internal):
            continue
        if adapter is None:
            yield f"% {name}: its adapter is not installed here"
        elif not adapter.references:
            yield f"% {name}: its adapter declares no reference"
        else:
            yield from adapter.references
