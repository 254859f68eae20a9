"""References to shipped checkpoints, from any working directory."""

import pytest

from robogauntlet_mergevla import zoo
from robogauntlet_mergevla.zoo import NotShipped, shipped


@pytest.fixture
def merged(tmp_path, monkeypatch):
    folder = tmp_path / "zoo" / "merged"
    (folder / "base").mkdir(parents=True)
    (folder / "card.json").touch()
    monkeypatch.setattr(zoo, "zoo_folder", lambda: tmp_path / "zoo")
    return folder


def test_a_shipped_name_is_found_in_any_working_directory(merged, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert shipped("zoo:merged") == merged.resolve()
    assert shipped("zoo:merged/base") == (merged / "base").resolve()


@pytest.mark.parametrize("reference", ["runs/mine", "/somewhere/else", "owner/name@v1"])
def test_any_other_reference_is_unchanged(reference):
    assert str(shipped(reference)) == reference


@pytest.mark.parametrize("name", ["", ".", "..", "../elsewhere", "/etc", "merged/nothing"])
def test_a_name_that_is_not_in_the_zoo_is_refused(merged, name):
    with pytest.raises(NotShipped, match="expected the name of a shipped checkpoint after 'zoo:'"):
        shipped(f"zoo:{name}")


def test_the_message_for_a_misspelt_name_has_the_nearest_one(merged):
    with pytest.raises(NotShipped, match="got 'mergd'; did you mean 'merged'"):
        shipped("zoo:mergd")


def test_without_an_installed_zoo_the_message_says_what_to_install(monkeypatch):
    monkeypatch.setattr(zoo, "PACKAGE", "no_such_zoo")
    zoo.zoo_folder.cache_clear()
    with pytest.raises(NotShipped, match=r"are not installed; in a clone of the repository: pip install \./zoo"):
        shipped("zoo:merged")
