"""`robogauntlet policies import`: its checkpoint, its output and what it refuses to overwrite."""

from functools import partial

import pytest

from robogauntlet_mergevla.checkpoints.metadata import CheckpointMetadata
from robogauntlet_mergevla.released import importing
from tests.full_disk import full_disk
from tests.mergevla.network.test_pretrained import LITTLE
from tests.mergevla.released.synthetic import save


@pytest.fixture(autouse=True)
def little(monkeypatch):
    monkeypatch.setattr(importing, "import_released", partial(importing.import_released, size=LITTLE))


@pytest.mark.parametrize("kind", ["mergevla", "vla-adapter", "prismatic"])
def test_a_released_checkpoint_becomes_one_of_ours(run_command, tmp_path, kind):
    folder = save(tmp_path / "released", kind)
    done = run_command("policies", "import", kind, str(folder), "--out", str(tmp_path / "new"), "--tokenizer", "mine")
    assert done.code == 0, done.err
    name = "little-self-attention" if kind == "vla-adapter" else "little"
    assert f"new: {name} from {kind}, 0.3 MB" in done.out
    metadata = CheckpointMetadata.verified(tmp_path / "new")
    assert (metadata.architecture.name, metadata.architecture.tokenizer) == (name, "mine")
    again = run_command("policies", "import", kind, str(folder), "--out", str(tmp_path / "new"))
    assert "expected a new folder for --out" in again.refusal


def test_a_checkpoint_that_cannot_be_written_is_one_line(run_command, tmp_path):
    folder = save(tmp_path / "released", "mergevla")
    with full_disk():
        done = run_command("policies", "import", "mergevla", str(folder), "--out", str(tmp_path / "new"))
    assert done.refusal.endswith("new: File too large")
