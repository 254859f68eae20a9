"""The paper's router on experts whose trunks begin alike, and on experts with trunks of their own, as in the paper.

`TRAINING_CONTROLS=FOLDER python -m studies merging --measure own_trunks` (default `runs/training-controls`) lets the
router choose from first observations, with the experts and merges that `training_controls.sh` made there. A row has
its decisions, as the experts' numbers in the order of their names, task by task, for each training.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import chain, product
from typing import Any

from studies.percent import folder_of
from studies.routing.routers import SUBSPACES, interval, observed, paper_routers, right
from studies.shared import EXPERT_VIEW, table_of

KINDS = {"cross-sigmoid": "from the base", "cross-sigmoid-fresh": "of their own"}
INSTRUCTION = {"read": True, "hidden": False}
PARTS = dict(zip(SUBSPACES, ("values", "keys", "both"), strict=True))
COLUMNS = {"trunks": "{trunks}", "router": "{router}", "instruction": "{instruction}"}
COLUMNS |= {name: f"{{{name}}}" for name in PARTS.values()}


def measure() -> list[dict[str, Any]]:
    """A row for each kind of trunk, router and instruction."""
    import torch

    from robogauntlet_mergevla.checkpoints.merged_checkpoint import load_merged
    from robogauntlet_mergevla.checkpoints.merged_model import MergedModel

    torch.set_num_threads(1)
    folder = folder_of("TRAINING_CONTROLS", "training-controls")
    rows: dict[tuple[str, str, str], dict[str, Any]] = {}
    for kind in KINDS:
        for path in (one.parent for one in sorted(folder.glob(f"{kind}-[0-9]*/paper"))):
            model = MergedModel(load_merged(str(path / "paper")).parts)
            seen = list(chain(*observed(model.experts, EXPERT_VIEW).values()))
            for name, scores in paper_routers(model, str(path / "experts"), SUBSPACES).items():
                router, _, parts = name.partition(":")
                for instruction, sees in INSTRUCTION.items():
                    row = rows.setdefault((kind, router, instruction), {"kind": kind, "router": router})
                    row["instruction"] = instruction
                    chosen = "".join(map(str, scores(seen, sees).argmax(dim=1).tolist()))
                    row.setdefault(f"decisions, {PARTS[parts or SUBSPACES[0]]}", []).append(chosen)
    ordered = [rows[key] for key in product(KINDS, ("paper-coded", "paper-written"), INSTRUCTION) if key in rows]
    found = counted(ordered)
    table_of(found, COLUMNS)
    return found


def counted(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The rows again, their rates from the kept decisions, of all trainings together."""
    found = []
    for row in rows:
        cells = {
            name: interval([its for one in row[f"decisions, {name}"] for its in right(one)]) for name in PARTS.values()
        }
        found.append(dict(row) | {"trunks": KINDS[row["kind"]]} | cells)
    return found
