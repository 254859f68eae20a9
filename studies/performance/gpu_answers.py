"""Action chunks per second on the GPU beside one core of the same machine, and how far their answers are apart.

`LARGE=FOLDER python -m studies performance --measure gpu_answers` writes 3 GB there for the larger network, and removes
them.
"""

import os
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studies.percent import few
from studies.shared import require_gpu, table_of

if TYPE_CHECKING:
    from robogauntlet.policies.contract import Policy
    from robogauntlet_mergevla.network.config import Architecture

BATCHES = (1, 8, 32)
SECONDS = few(400) / 100
"""Duration of a measurement (s)."""
COLUMNS = {
    "network": "{network}",
    "chunks/s of one core, one by one": "{core:.2f}",
    "batch on the GPU": "{batch}",
    "chunks/s of the GPU": "{gpu:.1f}",
    "GPU / core": "{ratio:.1f}",
    "largest difference of an action": "{difference:.1e}",
}


def measure() -> list[dict[str, Any]]:
    """Networks of both sizes with random weights."""
    from robogauntlet_mergevla.network.config import QWEN, TINY

    require_gpu()
    rows = []
    for name, architecture in (("`tiny`", TINY), ("`qwen2.5-0.5b`, bf16", replace(QWEN, tokenizer="words"))):
        with tempfile.TemporaryDirectory(dir=os.environ.get("LARGE")) as folder:
            rows += [{"network": name, **row} for row in compared(Path(folder), architecture)]
    table_of(rows, COLUMNS)
    return rows


def compared(folder: Path, architecture: "Architecture") -> list[dict[str, Any]]:
    """Rows of one size, a batch on the GPU each. Differences are shares of the largest action."""
    import torch

    from robogauntlet_mergevla.network.config import TINY
    from robogauntlet_mergevla.policies.single_policy import MergeVLAPolicy
    from tests.mergevla.experts import save_base
    from tests.mergevla.shared import query

    dtype = torch.float32 if architecture == TINY else torch.bfloat16
    base = save_base(folder / "network", architecture=architecture, dtype=dtype)
    core, gpu = (MergeVLAPolicy(base, device=device) for device in ("cpu", "cuda"))
    asked = [query(seed, architecture.image_size, task="null/All") for seed in range(max(BATCHES))]
    here, there = (policy.act(asked[:1])[0].actions for policy in (core, gpu))
    difference = float(np.abs(here - there).max() / np.abs(here).max())
    alone = speed(core, asked[:1])
    rows = []
    for batch in BATCHES:
        rate = speed(gpu, asked[:batch])
        rows.append({"batch": batch, "core": alone, "gpu": rate, "ratio": rate / alone, "difference": difference})
    return rows


def speed(policy: "Policy", asked: list[Any]) -> float:
    """Chunks per second (1/s)."""
    start, chunks = time.perf_counter(), 0
    while (passed := time.perf_counter() - start) < SECONDS or not chunks:
        chunks += len(policy.act(asked))
    return chunks / passed
