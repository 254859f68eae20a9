"""Writes a run as a folder in the layout of a repository of the Hugging Face hub.

With one policy it is a model repository, whose card has the results as `model-index`
(https://github.com/huggingface/hub-docs/blob/main/modelcard.md); the newer `.eval_results/` need a benchmark that is
registered on the hub. With several policies it is a dataset repository
(https://github.com/huggingface/hub-docs/blob/main/datasetcard.md).
"""

from __future__ import annotations

import json
import shutil
import tempfile
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import yaml

from robogauntlet.results.analysis.tables import CellRow, Tables
from robogauntlet.results.report.formatting import TextTable, count, escape, markdown, percent, span
from robogauntlet.results.report.parquet import write_parquet
from robogauntlet.results.report.summary import ReportPaths
from robogauntlet.results.run_document import RunDocument
from robogauntlet.results.store.episode_store import Store
from robogauntlet.suites.episode import AND, AT, CLEAN
from robogauntlet.support.errors import BadInput

CARD = "README.md"
TAGS = ("robogauntlet", "robotics", "evaluation")


def write_hub_folder(
    folder: Path, run: Path, document: RunDocument, tables: Tables, rows: Store, policy: str | None
) -> str:
    """Write `README.md`, `episodes.parquet`, `summary.json` and `report.html` into a new folder.

    Args:
        folder: The folder to create.
        run: The run folder, with its report.
        document: The run's document.
        tables: The run's numbers.
        rows: The run's rows.
        policy: The only policy of the card; by default that of a run with one policy.

    Returns:
        The type of repository, "model" or "dataset".

    Raises:
        BadInput: The run has no policy of that name, or no report of its present rows.
        OSError: The folder cannot be written.
    """
    evaluated = list(dict.fromkeys(cell.policy for cell in tables.cells))
    if policy is not None and policy not in evaluated:
        raise BadInput(f"no policy '{policy}'; the run has {', '.join(evaluated) or 'none'}")
    chosen = evaluated[0] if policy is None and len(evaluated) == 1 else policy
    report = ReportPaths.in_folder(run)
    try:
        reported = json.loads(report.summary.read_text(encoding="utf-8")).get("rows_hash")
    except (OSError, ValueError, AttributeError):
        reported = None
    if reported is None or reported != document.rows_hash or not report.html.is_file():
        raise BadInput(f"{run}: expected a report of its present rows; write it first: robogauntlet report {run}")
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{folder.name}.", dir=folder.parent) as scratch:
        made = Path(scratch) / folder.name  # a crash leaves no half of a folder
        made.mkdir()
        (made / CARD).write_text(hub_card(document, tables, chosen), encoding="utf-8")
        write_parquet(made / report.episodes.name, document, rows)
        for path in (report.summary, report.html):
            shutil.copyfile(path, made / path.name)
        made.rename(folder)
    return "dataset" if chosen is None else "model"


def hub_card(document: RunDocument, tables: Tables, policy: str | None) -> str:
    """Return the card: of a model if `policy` is given, else of a dataset with the episodes of all policies."""
    cells = [cell for cell in tables.cells if policy in (None, cell.policy)]
    title = f"{document.suite.name}: episodes of robot policies" if policy is None else policy
    front: dict[str, Any] = {"pretty_name": document.suite.name} if policy is None else {}
    if policy is None:
        front |= {"task_categories": ["robotics"], "tags": list(TAGS)}
        front["configs"] = [{"config_name": "episodes", "data_files": "episodes.parquet", "default": True}]
    else:
        front |= {"pipeline_tag": "robotics", "tags": list(TAGS)}
        results = [_result(document, cell) for cell in cells if cell.tally.rate is not None]
        front |= {"model-index": [{"name": policy, "results": results}]} if results else {}
    header = yaml.safe_dump(front, sort_keys=False, allow_unicode=True, width=1000)
    played = datetime.fromtimestamp(document.started_at, UTC).date().isoformat()
    lines = [
        *("---", header.rstrip(), "---", "", f"# {escape(title)}", ""),
        f"Success of {'robot policies' if policy is None else 'this policy'} in simulation, played by RoboGauntlet "
        f"on {played}. Rates have 95 % Wilson intervals; errors are neither successes nor failures.",
        "",
        markdown(_table(cells)),
        "",
        f"Suite {escape(document.suite.name)} (hash {document.suite_hash}), rows hash {document.rows_hash}, "
        f"status {document.status}.",
        "",
        "| file | content |",
        "|---|---|",
        "| `report.html` | the report |",
        "| `summary.json` | its numbers |",
        "| `episodes.parquet` | a row per episode, of all policies of the run |",
        "",
    ]
    return "\n".join(lines)


def _table(cells: list[CellRow]) -> TextTable:
    lines = []
    for cell in cells:
        tally = cell.tally
        numbers = (percent(tally.rate), span(tally.interval), count(tally.verdicts), count(tally.errors))
        lines.append((cell.task, cell.policy, _condition(cell), *numbers))
    return TextTable(("task", "policy", "condition", "success", "interval", "n", "errors"), tuple(lines), 3)


def _result(document: RunDocument, cell: CellRow) -> dict[str, Any]:
    """One result of `model-index`. A dataset is the suite, its configuration the task, its split the condition."""
    tally, interval = cell.tally, cell.tally.interval
    metrics = [{"type": "success_rate", "value": tally.rate, "name": f"success rate, n = {tally.verdicts}"}]
    if interval is not None:
        metrics += [
            {"type": "success_rate_low", "value": interval.low, "name": "lower end of the 95 % Wilson interval"},
            {"type": "success_rate_high", "value": interval.high, "name": "upper end of the 95 % Wilson interval"},
        ]
    return {
        "task": {"type": "robotics", "name": cell.task},
        "dataset": {
            "type": "robogauntlet",
            "name": document.suite.name,
            "config": cell.task,
            "split": _condition(cell),
            "args": {"suite_hash": document.suite_hash, "errors": tally.errors, "missing": tally.missing},
        },
        "metrics": metrics,
    }


def _condition(cell: CellRow) -> str:
    if cell.condition.is_combination:
        return str(cell.condition).replace(AT, "-").replace(AND, "-")
    return CLEAN if cell.axis == CLEAN else f"{cell.axis}-{cell.severity}"
