"""References to checkpoints: what the repository ships is found from anywhere."""

import subprocess
import sys
from pathlib import Path

import pytest

from policies import zoo
from policies.zoo import NotShipped, shipped


@pytest.fixture
def merged(tmp_path, monkeypatch):
    folder = tmp_path / "zoo" / "merged"
    (folder / "base").mkdir(parents=True)
    (folder / "card.json").touch()
    monkeypatch.setattr(zoo, "ZOO", tmp_path / "zoo")
    return folder


def test_a_shipped_name_is_found_whatever_the_working_directory(merged, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert shipped("zoo:merged") == merged.resolve()
    assert shipped("zoo:merged/base") == (merged / "base").resolve()


@pytest.mark.parametrize("reference", ["runs/mine", "/somewhere/else", "owner/name@v1"])
def test_any_other_reference_is_left_as_it_is(reference):
    assert str(shipped(reference)) == reference


@pytest.mark.parametrize("name", ["", ".", "..", "../elsewhere", "/etc", "merged/nothing"])
def test_a_name_that_is_none_of_the_zoos_is_refused(merged, name):
    with pytest.raises(NotShipped, match="expected the name of a shipped checkpoint after 'zoo:'"):
        shipped(f"zoo:{name}")


def test_a_misspelt_name_is_answered_with_the_nearest(merged):
    with pytest.raises(NotShipped, match="got 'mergd'; did you mean 'merged'"):
        shipped("zoo:mergd")


def test_without_a_zoo_nothing_is_shipped(tmp_path, monkeypatch):
    monkeypatch.setattr(zoo, "ZOO", tmp_path / "none")
    with pytest.raises(NotShipped, match="got 'merged'; there are none"):
        shipped("zoo:merged")


def test_finding_a_checkpoint_loads_no_torch():
    code = "import sys, policies.zoo; print('torch' in sys.modules)"
    root = Path(__file__).parents[2]
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=root)
    assert done.stdout.strip() == "False"
