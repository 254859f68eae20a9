"""Progress, signals and exit of the verbs that train."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

import typer
from rich.text import Text

from robogauntlet.orchestrator.cli.common import EXIT_INTERRUPTED, fail, out, print_line
from robogauntlet.orchestrator.live_display import Display
from robogauntlet.policies.contract import PolicyError
from robogauntlet.results.folder_lock import FolderError, lock_folder
from robogauntlet.support.durations import format_duration
from robogauntlet.support.errors import BadInput, describe_os_error_at
from robogauntlet.support.interrupts import SIGNALS

if TYPE_CHECKING:
    from robogauntlet_mergevla.training.finetune import TrainingResult, TrainingStatus
    from robogauntlet_mergevla.training.training_checkpoint import History

RISE = 0.05
"""Share by which a held-out loss may end above its lowest value without a warning."""


class TrainingProgress(Display):
    """A line with the step, losses, speed and time left."""

    def show(self, pace: TrainingStatus) -> None:
        """Show the latest numbers."""
        text = line(pace)
        self.draw(lambda: Text(text), lambda: [text], at_once=pace.step == pace.steps)


def line(pace: TrainingStatus) -> str:
    """Format progress: `step 400/2000  L1 0.081  held-out L1 0.093  6.2 steps/s  4 min 18 s left`."""
    parts = [
        f"step {pace.step}/{pace.steps}",
        f"{pace.objective.label} {pace.loss:.4f}",
        f"held-out {pace.objective.label} {pace.held_out:.4f}" if pace.held_out is not None else "",
        f"{pace.steps_per_s:.1f} steps/s" if pace.steps_per_s else "",
        f"{format_duration(pace.left_s)} left" if pace.left_s else "",
    ]
    return "  ".join(filter(None, parts))


@contextmanager
def needs_training_packages() -> Iterator[None]:
    """Turn a failed import within the block into BadInput with the command that installs the package."""
    try:
        yield
    except ModuleNotFoundError as error:
        remedy = "in a clone of the repository: pip install ./mergevla"
        raise BadInput(f"training: not installed (no module {error.name}); {remedy}") from None


@contextmanager
def stoppable() -> Iterator[Callable[[], bool]]:
    """Let the first Ctrl-C or SIGTERM stop the training after its step, and a second one interrupt it."""
    stopping = False

    def stop(number: int, frame: FrameType | None) -> None:
        nonlocal stopping
        if stopping:
            raise KeyboardInterrupt
        stopping = True

    before = {number: signal.signal(number, stop) for number in SIGNALS}
    try:
        yield lambda: stopping
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def run_training(
    folder: Path, train: Callable[[Callable[[TrainingStatus], None], Callable[[], bool]], TrainingResult]
) -> None:
    """Run `train(listener, stop)`, which writes to `folder`, and print its outcome.

    Raises:
        BadInput: The training cannot be run as requested.
        typer.Exit: The training was stopped early.
    """
    progress, new = TrainingProgress(out), not folder.exists()
    try:
        with lock_folder(folder), progress, stoppable() as stop:
            trained = train(progress.show, stop)
    except (PolicyError, FolderError):
        if new and [path.name for path in folder.glob("*")] == [".lock"]:
            (folder / ".lock").unlink()
            folder.rmdir()
        raise
    except OSError as error:
        raise BadInput(describe_os_error_at(error, folder)) from None
    if trained.metadata is None:
        fail(f"interrupted after step {trained.history.step}; give the same command to continue")
        raise typer.Exit(EXIT_INTERRUPTED)
    metrics, objective = trained.metadata.metrics, trained.objective
    held_out = f", held-out {metrics[key]:.4f}" if (key := f"held_out_{objective}") in metrics else ""
    took = format_duration(trained.history.seconds)
    print_line(f"{folder}: {objective.label} {metrics[f'train_{objective}']:.4f}{held_out} after {took}")
    if warning := rise(trained.history):
        fail(warning)


def rise(history: History) -> str | None:
    """Say that the held-out loss has risen noticeably since its lowest value, or None if it has not."""
    if not history.held_out:
        return None
    (step, lowest), (_, last) = min(history.held_out, key=lambda item: item[1]), history.held_out[-1]
    if last <= (1 + RISE) * lowest:
        return None
    return (
        f"the held-out loss was {lowest:.4f} after step {step} and is {last:.4f}: the training diverged or overfitted; "
        "try a smaller --learning-rate or fewer --steps"
    )
