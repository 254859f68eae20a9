"""SmolVLA and pi0.5 act as in LeRobot itself, from networks of their classes that are made small."""

import json
import shutil

import numpy as np
import pytest

from robogauntlet.policies import catalog
from robogauntlet.policies.contract import PolicyError
from tests.errors import one_line_error
from tests.policies.lerobot import language
from tests.policies.lerobot.asking import CHUNK, answers, make


@pytest.fixture(scope="module")
def python_of(newer, tmp_path_factory):
    """Kind to the Python that plays its checkpoints; that of pi0.5 makes its networks small."""
    small = tmp_path_factory.mktemp("small") / "python"
    small.write_text(f'#!/bin/sh\nshift\nexec {newer} -P {language.__file__} "$@"\n')  # shift: it is started with -P
    small.chmod(0o755)
    return {"smolvla": newer, "pi05": str(small)}


@pytest.mark.nightly
@pytest.mark.parametrize("kind", ["smolvla", "pi05"])
def test_actions_are_bit_identical_to_lerobots(python_of, tmp_path, monkeypatch, kind):
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    made = make(python_of["smolvla"], tmp_path, kind)
    policy = catalog.load("lerobot", {"checkpoint": str(made / kind), "python": python_of[kind]})
    assert policy.spec.chunk_length == CHUNK[kind]
    np.testing.assert_array_equal(*answers(policy, made, kind))
    policy.close()
    if kind == "pi05":
        assert_weights_that_do_not_fit_are_refused(made / kind, tmp_path / "other", python_of[kind])


def assert_weights_that_do_not_fit_are_refused(checkpoint, other, python):
    """LeRobot prints that it cannot load them, and goes on with random ones."""
    shutil.copytree(checkpoint, other)
    config = json.loads((other / "config.json").read_text())
    (other / "config.json").write_text(json.dumps({**config, "max_action_dim": 16}))
    with one_line_error(PolicyError, r"^policy 'lerobot': ValueError: expected weights that fit its config.json in "):
        catalog.load("lerobot", {"checkpoint": str(other), "python": python})
