"""The verbs that train: mistakes are one line with exit code 2, Ctrl-C stops between two steps."""

import signal

import pytest
from typer.testing import CliRunner

from robogauntlet.orchestrator.cli import app
from robogauntlet.orchestrator.cli.common import EXIT_INTERRUPTED, INPUT_ERRORS
from robogauntlet_mergevla.checkpoints.metadata import CheckpointMetadata
from robogauntlet_mergevla.cli.training_progress import run_training, stoppable
from robogauntlet_mergevla.training.batch_loss import Objective
from robogauntlet_mergevla.training.dataset_mixture import DatasetMixture
from robogauntlet_mergevla.training.finetune import TrainingResult, pretrain
from robogauntlet_mergevla.training.settings import Settings
from robogauntlet_mergevla.training.training_checkpoint import History
from tests.full_disk import full_disk
from tests.mergevla.shared import SMALL
from tests.mergevla.training.test_finetune import dataset


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return dataset(tmp_path_factory.mktemp("data"), "Reach")


@pytest.fixture(scope="module")
def base(data, tmp_path_factory):
    folder = tmp_path_factory.mktemp("base")
    pretrain(DatasetMixture.open([data]), SMALL, folder, Settings(steps=1, batch_size=4))
    return folder


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["pretrain", "{data}/none", "--out", "{out}"], "expected a dataset"),
        (["pretrain", "{data}", "--out", "{out}", "--size", "huge"], "expected one of tiny"),
        (["pretrain", "{data}", "--out", "{out}"], "expected 96 px images for architecture 'tiny'"),
        (
            ["finetune", "{data}", "--base", "{base}", "--out", "{out}", "--steps", "0"],
            "steps: expected greater than 0",
        ),
        (["finetune", "{data}", "--base", "{base}", "--out", "{out}", "--rank", "0"], "expected a LoRA rank"),
        (["finetune", "{data}", "--base", "{base}", "--out", "{out}", "--action-steps", "9"], "1 to 8 action steps"),
        (["finetune", "{data}", "--base", "{data}", "--out", "{out}"], "expected card.json"),
        (["finetune", "{data}", "--base", "none", "--out", "{out}"], "expected a checkpoint's folder or a hub id"),
        (["finetune", "{data}", "--base", "{base}", "--out", "{base}"], "expected a folder other than the base's"),
    ],
)
def test_a_mistake_is_one_line_and_leaves_nothing_behind(run_command, arguments, message, data, base, tmp_path):
    places = {"data": data, "base": base, "out": tmp_path / "out"}
    assert message in run_command("mergevla", *(argument.format(**places) for argument in arguments)).refusal
    assert not (tmp_path / "out").exists()


def finetune(data, base, folder, *more):
    arguments = [str(data), "--base", str(base), "--out", str(folder / "expert"), "--batch-size", "4", "--rank", "2"]
    return CliRunner().invoke(app, ["mergevla", "finetune", *arguments, *more])


def test_a_checkpoint_that_cannot_be_written_is_one_line(data, base, tmp_path):
    with full_disk():
        done = finetune(data, base, tmp_path, "--steps", "1")
    assert isinstance(done.exception, INPUT_ERRORS)
    assert str(done.exception) == f"{tmp_path / 'expert'}: File too large"


def test_an_expert_can_be_trained_from_the_command_line(data, base, tmp_path):
    done = finetune(data, base, tmp_path, "--steps", "2", "--action-steps", "3")
    assert done.exit_code == 0, done.exception
    assert "step 2/2  L1 " in done.output
    metadata = CheckpointMetadata.read(tmp_path / "expert")
    assert (metadata.tasks, metadata.action_steps) == (("null/Reach",), 3)


def test_an_expert_can_be_trained_from_several_datasets_of_its_task(data, base, tmp_path):
    other = dataset(tmp_path, "Reach", range(20, 24))
    done = finetune(data, base, tmp_path, str(other), "--steps", "2")
    assert done.exit_code == 0, done.exception
    assert CheckpointMetadata.read(tmp_path / "expert").metrics["frames"] == DatasetMixture.open([data, other]).frames


@pytest.mark.parametrize(("last", "warns"), [(0.1767, False), (0.185, False), (0.1977, True)])
def test_a_held_out_loss_that_has_risen_is_a_warning(base, tmp_path, capsys, last, warns):
    history = History("", 14000, held_out=[(250, 0.1889), (1250, 0.1767), (14000, last)])
    trained = TrainingResult(CheckpointMetadata.read(base), history, Objective.L1)
    run_training(tmp_path / "expert", lambda listener, stop: trained)
    warning = capsys.readouterr().err
    assert bool(warning) == warns
    if warns:
        assert "the held-out loss was 0.1767 after step 1250 and is 0.1977" in warning
        assert "try a smaller --learning-rate" in warning


def test_the_first_interrupt_stops_after_the_step_and_the_second_at_once():
    with stoppable() as stop:
        assert not stop()
        signal.raise_signal(signal.SIGINT)
        assert stop()
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)


def test_an_interrupted_training_exits_as_interrupted_and_continues(data, tmp_path, capsys):
    pool, settings = DatasetMixture.open([data]), Settings(steps=3, batch_size=4)

    def train(listener, stop):
        def interrupt(pace):
            listener(pace)
            if pace.step == 1:
                signal.raise_signal(signal.SIGINT)

        return pretrain(pool, SMALL, tmp_path, settings, listener=interrupt, stop=stop)

    with pytest.raises(BaseException, match=str(EXIT_INTERRUPTED)):
        run_training(tmp_path, train)
    assert "interrupted after step 1; give the same command to continue" in capsys.readouterr().err
    run_training(tmp_path, train)
    assert CheckpointMetadata.read(tmp_path).metrics["steps"] == 3
