"""A model of the paper's size with random weights: merged, routed, and playing an episode on the CPU.

`PAPER_SIZE=FOLDER python -m studies performance --measure paper_size` writes 9 GB there, and removes them.
"""

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import psutil

from studies.percent import IS_PART
from studies.shared import GAUNTLET, stored_rows, table_of

if TYPE_CHECKING:
    from robogauntlet_mergevla.network.config import Architecture

TASKS = ("pybullet/PandaReach-v3", "pybullet/PandaPush-v3", "pybullet/PandaPickAndPlace-v3", "robosuite/Lift")
PLAYED = TASKS[0]
RANK = 32
"""Rank of the adapters (arXiv 2511.18810, table 6)."""
SPREAD = 0.02
"""Standard deviation of the random weights."""
GB = 1e9
COLUMNS = {
    "step": "{step}",
    "command": "{command}",
    "time": "{seconds:.0f} s",
    "memory": "{memory}",
    "files mapped": "{files}",
    "written": "{written}",
}
SUITE = """
name: paper_size
policies:
  - {{name: merged, kind: mergevla-merged, options: {{checkpoint: {checkpoint}, router: paper-coded}}}}
tasks: [{task}]
seeds: {{count: 1}}
image_size: {size}
render_profile: fast
workers: 1
episode_time_limit_s: 3600
"""


def architecture() -> "Architecture":
    """The paper's size; of a share, the size of the zoo."""
    from robogauntlet_mergevla.network.config import QWEN, TINY

    return TINY if IS_PART else QWEN


def measure() -> list[dict[str, Any]]:
    """A row for each step, and one for the parts of the episode."""
    with tempfile.TemporaryDirectory(dir=os.environ.get("PAPER_SIZE")) as name:
        rows = steps(Path(name))
    table_of(rows, COLUMNS)
    return rows


def steps(folder: Path) -> list[dict[str, Any]]:
    """Run the steps in a folder."""
    code = f"from pathlib import Path; from {__name__} import InFolder; InFolder(Path({str(folder)!r}))"
    run([sys.executable, "-c", code + ".base()"], folder)
    run([sys.executable, "-c", code + ".experts()"], folder)
    merge = ["mergevla", "merge", "experts", "--operator", "ties", "--trunk", "mean", "--out", "merged"]
    rows = [row("four experts merged: TIES, task masks, averaged trunk, k = 1", merge, folder, "merged")]
    shutil.rmtree(folder / "experts")
    return rows + played(folder)


def played(folder: Path) -> list[dict[str, Any]]:
    """Play an episode with the merged model; a row of the command, and of parts of the episode."""
    (folder / "suite.yaml").write_text(
        SUITE.format(checkpoint=folder / "merged", task=PLAYED, size=architecture().image_size)
    )
    play = ["run", "suite.yaml", "--out", "run", "--no-media"]
    rows = [row("an episode of " + PLAYED, play, folder, None)]
    (episode,) = stored_rows(folder / "run")
    shown = f"{episode.status}, {episode.steps} steps, {episode.queries} queries, routed to {episode.inferred_task}"
    print(shown, flush=True)
    if episode.error:
        raise RuntimeError(episode.error)
    for step, seconds in (
        ("of it: loading the policy", episode.load_s),
        ("of it: routing, a pass of each of four experts", episode.routing_s),
        (f"of it: the other {episode.queries - 1} answers, each", episode.query_p50_s),
    ):
        rows.append({"step": step, "command": "", "seconds": seconds, "memory": "", "files": "", "written": ""})
    return rows


def row(step: str, command: Sequence[str], folder: Path, out: str | None) -> dict[str, Any]:
    """Run a command and return its time (s), its memory and the size of what it wrote (GB)."""
    print(f"robogauntlet {' '.join(command)}", flush=True)
    used = run([*GAUNTLET, *command], folder)
    written = sum(path.stat().st_size for path in (folder / out).iterdir()) / GB if out else 0.0
    print(f"  {used}, {written:.2f} GB written", flush=True)
    sizes = {"memory": f"{used['own']:.1f} GB", "files": f"{used['mapped']:.1f} GB"}
    shown = f"`robogauntlet {' '.join(command)}`"
    return {"step": step, "command": shown, **used, **sizes, "written": f"{written:.1f} GB" if out else ""}


def run(command: Sequence[str], folder: Path) -> dict[str, float]:
    """Run a command in a folder; return its time (s) and the greatest memory of all of its processes (GB).

    `own` is memory that only they hold, `mapped` that of files which they read, which the system can take back.
    """
    paths = [str(Path(__file__).parents[2]), str(Path(__file__).parents[2] / "src")]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths), "OMP_NUM_THREADS": "1"}
    start, own, mapped = time.monotonic(), 0.0, 0.0
    with (folder / "output.txt").open("ab") as output:
        process = subprocess.Popen(command, cwd=folder, env=environment, stdout=output, stderr=output)
        while process.poll() is None:
            sizes = [_memory(member) for member in _tree(process.pid)]
            own, mapped = max(own, sum(size[0] for size in sizes)), max(mapped, *(size[1] for size in sizes), 0.0)
            time.sleep(0.1)
    if process.returncode:
        raise RuntimeError((folder / "output.txt").read_text()[-2000:])
    return {"seconds": time.monotonic() - start, "own": own, "mapped": mapped}


def _tree(pid: int) -> list[int]:
    try:
        return [pid, *(child.pid for child in psutil.Process(pid).children(recursive=True))]
    except psutil.NoSuchProcess:
        return []


def _memory(pid: int) -> tuple[float, float]:
    """Memory of a process that is its own, and that of files (GB)."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return 0.0, 0.0
    sizes = {line.split(":")[0]: int(line.split()[1]) * 1024 for line in lines if line.startswith("Rss")}
    return (sizes.get("RssAnon", 0) + sizes.get("RssShmem", 0)) / GB, sizes.get("RssFile", 0) / GB


class InFolder:
    """What has to be there before the commands, made in a process of its own."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.architecture = folder, architecture()

    def base(self) -> None:
        """A base with random weights in bf16."""
        from robogauntlet_mergevla.checkpoints.expert_checkpoint import save_checkpoint
        from robogauntlet_mergevla.checkpoints.metadata import CheckpointMetadata
        from robogauntlet_mergevla.network.model import build
        from tests.mergevla.shared import task_statistics

        metadata = CheckpointMetadata(self.architecture, task_statistics())
        save_checkpoint(self.folder / "base", build(self.architecture, seed=0).bfloat16(), metadata)

    def experts(self) -> None:
        """An expert for each task: random adapters, and a trunk of its own initialisation, as the paper's have."""
        import torch

        from robogauntlet_mergevla.checkpoints.expert_checkpoint import load_checkpoint, save_checkpoint
        from robogauntlet_mergevla.checkpoints.metadata import CheckpointMetadata
        from robogauntlet_mergevla.network.config import LoraSettings
        from robogauntlet_mergevla.network.lora import add_lora
        from robogauntlet_mergevla.network.model import trunk
        from tests.mergevla.shared import task_statistics

        lora = LoraSettings(min(RANK, self.architecture.width))
        for seed, task in enumerate(TASKS, start=1):
            model = load_checkpoint(self.folder / "base").model
            model.load_state_dict({n: w.bfloat16() for n, w in trunk(model.architecture, seed).items()}, strict=False)
            add_lora(model, lora, seed)
            torch.manual_seed(seed)
            with torch.no_grad():
                for name, weight in model.named_parameters():
                    if ".lora_" in name:
                        weight.copy_(torch.randn(weight.shape) * SPREAD)
            metadata = CheckpointMetadata(model.architecture, task_statistics(seed, task), lora=lora)
            save_checkpoint(self.folder / "experts" / str(seed), model.bfloat16(), metadata, base=self.folder / "base")
