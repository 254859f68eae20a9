"""BibTeX for a paper, which `robogauntlet report --cite` prints."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import robogauntlet
from robogauntlet.adapters import catalog
from robogauntlet.results.report.formatting import escape_latex
from robogauntlet.results.run_document import RunDocument, read_run

YEAR = 2026
"""Of the version that CITATION.cff names."""


def bibtex(folder: Path | None) -> str:
    """Return BibTeX of RoboGauntlet, and of the suite and the simulators of a run.

    With a run, the version is that which played it. The suite's entry has the hash of the suite and that of the run's
    rows. Published benchmarks, such as LIBERO and Meta-World, are among the simulators.
    """
    document = None if folder is None else read_run(folder)
    entries = [_tool(document)]
    if document is not None:
        entries += [_suite(document), *_simulators(document)]
    return "\n\n".join(dict.fromkeys(entries)) + "\n"


def _tool(document: RunDocument | None) -> str:
    version = robogauntlet.__version__
    fields = {
        "title": "{RoboGauntlet}: Reproducible, statistically sound evaluation of robot policies across simulators",
        "author": "{RoboGauntlet contributors}",
        "year": str(YEAR),
        "version": version if document is None else document.provenance.packages.get("robogauntlet", version),
    }
    return _entry("software", "robogauntlet", fields)


def _suite(document: RunDocument) -> str:
    name = _escaped(document.suite.name)
    rows = document.rows_hash or "not computed"
    fields = {
        "title": f"{{{name}}}: an evaluation suite of {{RoboGauntlet}}",
        "year": str(datetime.fromtimestamp(document.started_at, UTC).year),
        "note": f"Suite hash {document.suite_hash}; run {_escaped(document.run_id)}, rows hash {rows}",
    }
    return _entry("misc", f"robogauntlet-suite-{document.suite_hash[:8]}", fields)


def _entry(kind: str, key: str, fields: dict[str, str]) -> str:
    lines = ",\n".join(f"  {name} = {{{value}}}" for name, value in fields.items())
    return f"@{kind}{{{key},\n{lines}\n}}"


def _escaped(text: str) -> str:
    """A text for LaTeX in which BibTeX, which counts escaped braces too, finds every brace closed."""
    escaped = escape_latex(text)
    return escaped.replace(r"\{", r"\textbraceleft{}").replace(r"\}", r"\textbraceright{}")


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
