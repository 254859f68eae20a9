"""The folder in which each case is typed: good files of every kind, and some that are of none."""

import shutil
from collections.abc import Callable, Mapping
from contextlib import closing
from pathlib import Path

from robogauntlet.results.record import outcome_row, rows_hash
from robogauntlet.results.run_document import read_run, store_url
from robogauntlet.results.store.episode_store import Store
from robogauntlet.results.store.exported_run import export_run
from tests.mergevla.experts import save_experts
from tests.mergevla.training.test_finetune import dataset
from tests.results.synthetic import cells, document, row, run_folder

SUITE = "name: s\npolicies: [random]\ntasks: [null/Reach]\nseeds: {count: 2}\n"
RUN_ID = "0123456789abcdef0123456789abcdef"
SEEDS = 3
PLAN = cells(("p", "q"), ("maniskill/PushCube-v1",))
EPISODE = PLAN[0].episode(0).id
"""Of the run `runs/monday`."""
Content = str | bytes | Callable[[bytes], bytes] | None
"""What is written into a file: text, bytes, or what becomes of its bytes. None makes a folder, and removes a file."""


def fill(folder: Path) -> None:
    """Write the files: a suite, two runs, an exported run, experts, a dataset, and files that are none of these."""
    (folder / "suite.yaml").write_text(SUITE)
    for number, day in enumerate(("monday", "tuesday")):
        _save(folder / "runs" / day, run_id=f"{number}{RUN_ID[1:]}", started_at=1.0 + number)
    _save(folder / "sent", run_id=f"f{RUN_ID[1:]}", started_at=1.0)  # which the history does not know
    export(folder / "sent", folder / "run.zip")
    shutil.rmtree(folder / "sent")
    save_experts(folder, tasks=("null/Reach", "null/Slow"))
    dataset(folder / "data", "Reach", range(2))
    (folder / "text").write_text("hello\n")
    (folder / "empty").touch()
    (folder / "byte").write_bytes(b"x")
    (folder / "notes").mkdir()
    (folder / "notes" / "mine.txt").write_text("mine\n")


def content(folder: Path) -> dict[str, bytes | None]:
    """Every path below a folder with its bytes, None for folders."""
    return {str(path.relative_to(folder)): None if path.is_dir() else path.read_bytes() for path in folder.rglob("*")}


def write(folder: Path, files: Mapping[str, Content]) -> None:
    """Write files below a folder."""
    for name, text in files.items():
        path = folder / name
        if callable(text):
            path.write_bytes(text(path.read_bytes()))
        elif text is None:
            path.unlink() if path.is_file() else path.mkdir(parents=True, exist_ok=True)
        else:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(text if isinstance(text, bytes) else text.encode("utf-8", "surrogatepass"))


def restore(folder: Path, before: Mapping[str, bytes | None], now: Mapping[str, bytes | None]) -> None:
    """Make a folder, of which `content` finds `now`, what it found before."""
    for name in sorted(now, reverse=True):  # what is in a folder goes before it
        if name not in before or (now[name] is None) != (before[name] is None):
            path = folder / name
            path.rmdir() if path.is_dir() and not path.is_symlink() else path.unlink()
    write(folder, {name: text for name, text in before.items() if now.get(name, ...) != text})


def export(run: Path, file: Path) -> None:
    """Export a run of `fill`."""
    saved = read_run(run)
    with closing(Store.open(store_url(run, saved), saved.run_id)) as store:
        export_run(run, saved, store, file)


def _save(folder: Path, **changes) -> None:
    rows = [row(cell, seed) for cell in PLAN for seed in range(SEEDS)]
    run_folder(folder, document(SEEDS, PLAN, rows_hash=rows_hash(map(outcome_row, rows)), **changes), rows)
