"""The steps of the benchmark `paper_size` with a little network, without the simulator."""

import numpy as np
from typer.testing import CliRunner

from robogauntlet.orchestrator.cli import app
from robogauntlet.policies.mergevla.options import merged_options
from robogauntlet.policies.mergevla.policies.merged_policy import MergedPolicy
from robogauntlet.policies.mergevla.released.importing import import_released, save_imported
from robogauntlet.policies.mergevla.released.names import Kind
from tests.benchmarks.paper_size import PLAYED, TASKS, InFolder
from tests.policies.mergevla.network.test_pretrained import LITTLE
from tests.policies.mergevla.shared import query


def test_a_released_base_is_imported_merged_with_four_experts_and_routed(tmp_path):
    made = InFolder(tmp_path, LITTLE)
    made.released()
    save_imported(import_released(Kind.PRISMATIC, [tmp_path / "released.pt"], size=LITTLE), tmp_path / "base")
    made.experts()
    options = ["--operator", "ties", "--trunk", "mean", "--out", str(tmp_path / "merged")]
    done = CliRunner().invoke(app, ["policies", "merge", str(tmp_path / "experts"), *options])
    assert done.exit_code == 0, done.output
    policy = MergedPolicy.of(merged_options({"checkpoint": str(tmp_path / "merged"), "router": "paper-coded"}))
    (decision,) = policy.act([query(0, LITTLE.image_size, task=PLAYED)])
    assert decision.actions.shape == (8, 7)
    assert np.isfinite(decision.actions).all()
    assert decision.routing.choice in TASKS
