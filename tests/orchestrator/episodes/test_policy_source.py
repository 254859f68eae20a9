"""Policies built on nodes with their files, with other files, and without files."""

import shutil
import tempfile
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from robogauntlet.orchestrator.episodes.episode_runner import EpisodeRunner
from robogauntlet.orchestrator.episodes.policy_source import (
    PolicyBundle,
    PolicySource,
    build_policy,
    bundle_cache_dir,
    bundle_layout,
    resolve_locally,
    with_bundles,
)
from robogauntlet.orchestrator.scheduling.ray_worker_pool import RayWorkerPool
from robogauntlet.orchestrator.scheduling.scheduler import Scheduler, SchedulerOptions
from robogauntlet.orchestrator.scheduling.work_queue import work_queues
from robogauntlet.policies import catalog
from robogauntlet.policies.contract import PolicyError, PolicyFiles
from robogauntlet.results.record import outcome_row
from robogauntlet.suites.episode import Cell, Protocol, View
from robogauntlet_mergevla.checkpoints.merged_checkpoint import save_merged
from robogauntlet_mergevla.merging.recipe import Recipe
from tests.full_disk import no_space
from tests.mergevla.experts import merging, save_experts

PART = st.text("abc", min_size=1, max_size=3)
PATH = st.lists(PART, min_size=1, max_size=4).map(lambda parts: Path("/", *parts))


@pytest.fixture
def folder(tmp_path):
    """A base, three experts and their merged model."""
    made = merging(save_experts(tmp_path / "zoo"))
    save_merged(tmp_path / "zoo" / "merged", made)
    save_merged(tmp_path / "zoo" / "referring", made, weights=False)
    return tmp_path / "zoo"


@pytest.fixture(autouse=True)
def temporary(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    return tmp_path / "temporary"


def planned(kind, **options):
    return PolicySource(kind, options, catalog.digest(kind, options))


def with_bundle(source, fetched=None):
    """The source with a bundle in this process's memory, which records fetched files."""
    options, files = bundle_layout(catalog.find(source.kind).files(source.options))

    def kept(name, content):
        return lambda: fetched.append(name) or content

    fetched = [] if fetched is None else fetched
    contents = {name: kept(name, path.read_bytes()) for name, path in files.items()}
    return PolicySource(source.kind, source.options, source.digest, PolicyBundle(options, contents))


def sources(folder):
    experts = str(folder / "experts")
    return {
        "one": planned("mergevla", checkpoint=str(folder / "experts" / "null-Reach")),
        "base": planned("mergevla", checkpoint=str(folder / "base")),
        "experts": planned("mergevla-experts", folder=experts),
        "merged": planned("mergevla-merged", checkpoint=str(folder / "merged"), router="oracle"),
        "referring": planned("mergevla-merged", checkpoint=str(folder / "referring"), router="oracle"),
        "remerged": planned(
            "mergevla-merged",
            checkpoint=str(folder / "merged"),
            router="oracle",
            experts=experts,
            recipe=Recipe().as_json(),
        ),
    }


@given(st.dictionaries(PART, PATH, min_size=1, max_size=3), st.lists(PATH, min_size=1, max_size=6, unique=True))
def test_a_bundle_keeps_the_relative_paths_of_its_files(options, files):
    places, contents = bundle_layout(PolicyFiles(options, tuple(files)))
    roots = {Path(str(path)[: len(str(path)) - len(name)]) for name, path in contents.items() if name != "."}
    assert len(roots) <= 1
    for root in roots:
        assert {name: root / place for name, place in places.items()} == options


@pytest.mark.parametrize("name", ["one", "base", "experts", "merged", "referring", "remerged"])
def test_a_node_without_the_files_builds_the_same_policy_from_the_bundle(folder, name):
    source = with_bundle(sources(folder)[name])
    shutil.rmtree(folder)
    copy = resolve_locally(source)
    assert catalog.digest(copy.kind, copy.options) == source.digest
    assert build_policy(source).spec == catalog.spec(copy.kind, copy.options)


def test_a_node_with_the_files_fetches_nothing(folder):
    fetched = []
    source = with_bundle(sources(folder)["merged"], fetched)
    assert resolve_locally(source) is source
    assert fetched == []


def test_a_node_with_other_files_uses_the_bundle(folder):
    source = with_bundle(sources(folder)["one"])
    card = folder / "experts" / "null-Reach" / "card.json"
    shutil.copy(folder / "experts" / "null-Slow" / "card.json", card)
    assert resolve_locally(source) != source


def test_a_node_fetches_once(folder):
    fetched = []
    source = with_bundle(sources(folder)["experts"], fetched)
    shutil.rmtree(folder)
    first = resolve_locally(source)
    assert len(fetched) == len(set(fetched)) == 8
    assert resolve_locally(source) == first
    assert len(fetched) == 8


def test_a_partly_deleted_copy_is_fetched_again(folder):
    """For example by programs that clean the folder for temporary files."""
    source = with_bundle(sources(folder)["experts"])
    shutil.rmtree(folder)
    resolve_locally(source)
    next(bundle_cache_dir(source.digest).rglob("model.safetensors")).unlink()
    copy = resolve_locally(source)
    assert catalog.digest(copy.kind, copy.options) == source.digest


def test_missing_files_without_a_bundle_are_an_error(folder):
    source = sources(folder)["one"]
    shutil.rmtree(folder)
    with pytest.raises(PolicyError, match="expected a checkpoint's folder or a hub id"):
        resolve_locally(source)


def test_a_bundle_of_other_files_is_an_error(folder):
    one, other = with_bundle(sources(folder)["one"]), with_bundle(sources(folder)["merged"])
    wrong = PolicySource(one.kind, one.options, one.digest, PolicyBundle(one.bundle.options, other.bundle.files))
    shutil.rmtree(folder)
    with pytest.raises(PolicyError):
        resolve_locally(wrong)


def test_a_full_disk_is_an_error_and_leaves_no_partial_copy(folder, temporary):
    source = with_bundle(sources(folder)["one"])
    files = dict(source.bundle.files)
    files[sorted(files)[-1]] = no_space
    source = PolicySource(source.kind, source.options, source.digest, PolicyBundle(source.bundle.options, files))
    shutil.rmtree(folder)
    with pytest.raises(PolicyError, match=r"cannot be copied to .*: No space left on device"):
        resolve_locally(source)
    left = [path.name for path in temporary.rglob("*") if path.is_file() or "partial" in path.name]
    assert left == [f"{source.digest}.lock"]


@pytest.mark.ray
def test_workers_without_the_files_play_the_same_rows(folder, ray_here, observer):
    known = {name: source for name, source in sources(folder).items() if name in ("experts", "merged")}
    protocol = Protocol(8, 4, View(("third_person", "wrist"), 16))
    work = [(Cell(name, source.digest, "null/Reach", protocol), range(3)) for name, source in known.items()]
    options = SchedulerOptions({"null": 1}, episode_time_limit_s=120.0, allowed_errors=0)

    runner = EpisodeRunner(known)
    before = sorted(outcome_row(runner.play_one(cell.episode(seed))) for cell, seeds in work for seed in seeds)
    sent = with_bundles(known)
    shutil.rmtree(folder)
    found = []
    Scheduler(work_queues(work, 1), RayWorkerPool(sent), options, found.extend, observer).run()
    assert sorted(map(outcome_row, found)) == before
