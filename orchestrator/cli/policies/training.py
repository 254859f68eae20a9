"""What the verbs that train share: how it goes on screen, how a signal stops it, and how it ends."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

import typer
from rich.text import Text

from orchestrator.cli.shared import EXIT_INTERRUPTED, BadInput, fail, out
from orchestrator.display import Display
from orchestrator.folders import FolderError, explain_at, locked
from orchestrator.progress import format_duration
from policies.contract import PolicyError

if TYPE_CHECKING:
    from policies.training.finetune import Pace, Trained

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class TrainingProgress(Display):
    """One line with step, losses, pace and time left."""

    def show(self, pace: Pace) -> None:
        """Refresh what is shown."""
        said = line(pace)
        self.draw(lambda: Text(said), lambda: [said], at_once=pace.step == pace.steps)


def line(pace: Pace) -> str:
    """`step 400/2000  L1 0.081  held-out L1 0.093  6.2 steps/s  4 min 18 s left`."""
    parts = [
        f"step {pace.step}/{pace.steps}",
        f"L1 {pace.loss:.4f}",
        f"held-out L1 {pace.held_out:.4f}" if pace.held_out is not None else "",
        f"{pace.steps_per_s:.1f} steps/s" if pace.steps_per_s else "",
        f"{format_duration(pace.left_s)} left" if pace.left_s else "",
    ]
    return "  ".join(filter(None, parts))


@contextmanager
def needs_training_packages() -> Iterator[None]:
    """Say in one line which package is missing for what is imported within the block."""
    try:
        yield
    except ModuleNotFoundError as error:
        raise BadInput(
            f"training needs the packages of robogauntlet[mergevla], found none named {error.name}"
        ) from None


@contextmanager
def stoppable() -> Iterator[Callable[[], bool]]:
    """Let the first Ctrl-C or SIGTERM ask the training to stop between two steps; a second one interrupts it."""
    asked = False

    def ask(number: int, frame: FrameType | None) -> None:
        nonlocal asked
        if asked:
            raise KeyboardInterrupt
        asked = True

    before = {number: signal.signal(number, ask) for number in SIGNALS}
    try:
        yield lambda: asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def run_training(folder: Path, train: Callable[[Callable[[Pace], None], Callable[[], bool]], Trained]) -> None:
    """Run `train(listener, stop)`, which writes to `folder`, and say how it ended.

    Raises:
        BadInput: What was asked for cannot be.
        typer.Exit: It was stopped before its end.
    """
    progress, new = TrainingProgress(out), not folder.exists()
    try:
        with locked(folder), progress, stoppable() as stop:
            trained = train(progress.show, stop)
    except (PolicyError, FolderError) as error:
        if new:
            _remove_if_unused(folder)
        raise BadInput(str(error)) from None
    except OSError as error:
        raise BadInput(explain_at(error, folder)) from None
    if trained.card is None:
        fail(f"interrupted after step {trained.history.step}; give the same command to continue")
        raise typer.Exit(EXIT_INTERRUPTED)
    metrics = trained.card.metrics
    held_out = f", held-out {metrics['held_out_l1']:.4f}" if "held_out_l1" in metrics else ""
    took = format_duration(trained.history.seconds)
    out.print(f"{folder}: L1 {metrics['train_l1']:.4f}{held_out} after {took}", markup=False, soft_wrap=True)


def _remove_if_unused(folder: Path) -> None:
    """Leave nothing behind for a mistyped command."""
    if [path.name for path in folder.glob("*")] == [".lock"]:
        (folder / ".lock").unlink()
        folder.rmdir()
