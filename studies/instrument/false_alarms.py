"""How often a build is called worse than itself on other seeds: it is compared with itself on disjoint blocks of seeds.

The commands refuse two runs that share no episode. So the episodes of the second block take the identities of the
first, as if they were of the same start states; every test then sees independent outcomes of equal rates.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from studies.instrument.draws import DRAWS, SEEDS, answers, builds, rows_of_run
from studies.instrument.instrument import DEFECTS, TASKS
from studies.instrument.series import searched
from studies.percent import IS_PART
from studies.shared import table_of

LEAST, MOST = (0.0, 1.0) if IS_PART else (0.1, 0.97)
"""Success of the builds that are compared with themselves; others hardly have outcomes that differ."""
VERBS = {"compare": "`compare`", "gate": "`compare --gate`", "search": "ends of `search checkpoint`"}
COLUMNS = {"seeds in a block": "{seeds}"} | {title: f"{{{verb}}}" for verb, title in VERBS.items()}


def measure() -> list[dict[str, Any]]:
    """A row for each number of seeds: shares in which a build is called different from itself, or worse."""
    rows: list[dict[str, Any]] = []
    compared = {name: (run, rows_of_run(run)) for name, run in builds().items()}
    rates = {name: (own["status"] == "success").mean() for name, (_, own) in compared.items()}
    chosen = {name: compared[name] for name, rate in rates.items() if LEAST <= rate <= MOST}
    print(f"builds: {', '.join(chosen)}", flush=True)
    for count in SEEDS:
        shares = {name: _shares(run, own, count) for name, (run, own) in chosen.items()}
        rows.append({"seeds": count} | {verb: _mean_and_most(shares, verb) for verb in VERBS})
    table_of(rows, COLUMNS)
    return rows


def _mean_and_most(shares: Mapping[str, Mapping[str, float]], verb: str) -> str:
    own = {name: share[verb] for name, share in shares.items()}
    most = max(own, key=lambda name: own[name])
    return f"{100 * np.mean([*own.values()]):.1f} %, at most {100 * own[most]:.1f} % ({DEFECTS[most]})"


def _shares(run: Any, rows: pd.DataFrame, count: int) -> dict[str, float]:
    generator, seeds, found = np.random.default_rng(count), np.unique(rows["seed"]), []
    for _ in range(DRAWS):
        drawn = generator.permutation(seeds)[: 2 * count]
        blocks = [_in_order(rows[rows["seed"].isin(half)]) for half in (drawn[:count], drawn[count:])]
        same = {name: blocks[0][name].to_numpy() for name in ("pair_id", "seed", "state_hash")}
        blocks[1] = blocks[1].assign(**same)
        said = answers(run, run, *blocks)
        good, bad = (_outcomes(block) for block in blocks)
        found.append((said.compare, said.gate, searched(np.stack([good, bad], axis=2)) is not None))
    return dict(zip(VERBS, np.mean(found, axis=0), strict=True))


def _in_order(rows: pd.DataFrame) -> pd.DataFrame:
    return rows.sort_values(["task", "seed"], ignore_index=True)


def _outcomes(rows: pd.DataFrame) -> NDArray[np.float64]:
    """Outcomes of a block, shape (seeds, tasks)."""
    return (rows["status"] == "success").to_numpy(float).reshape(len(TASKS), -1).T
