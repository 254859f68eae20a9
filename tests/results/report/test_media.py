"""What a report shows beside its numbers."""

from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image

from robogauntlet.results.media_paths import snapshot_path, video_path
from robogauntlet.results.report import write_report
from robogauntlet.results.report.media import collect_media
from robogauntlet.results.report.parquet import read_frame
from robogauntlet.suites.episode import Condition
from tests.results.synthetic import cells, document, row, rows_where, run_folder

CLEAN, BLUR2, BLUR4 = Condition(), Condition("blur", 2), Condition("blur", 4)
TASKS = ("maniskill/PushCube-v1", "robosuite/Lift")
PLAN = cells(("oracle", "experts"), TASKS, (CLEAN, BLUR2, BLUR4))
DOCUMENT = document(3, PLAN, oracle_gate="oracle")


@pytest.fixture
def folder(tmp_path):
    """Experts succeed under the clean condition and fail blurred; the oracle, the gate, fails at severity 4."""
    highest = {"oracle": 2, "experts": 0}
    rows = rows_where(lambda cell, seed: cell.condition.severity <= highest[cell.policy], PLAN, 3)
    return run_folder(tmp_path / "run", DOCUMENT, rows)


def save_video(folder, cell, seed, size=100):
    path = video_path(folder, cell.episode(seed).id)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"x" * size)


def save_snapshot(folder, task, condition, shade):
    path = snapshot_path(folder, task, condition)
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.full((32, 64, 3), shade, np.uint8)).save(path)


def media(folder, **options):
    return collect_media(folder, DOCUMENT, read_frame(write_report(folder).paths.episodes), **options)


def cell_of(policy, task, condition):
    return next(c for c in PLAN if (c.policy, c.task, c.condition) == (policy, task, condition))


def test_videos_are_captioned_with_the_kind_of_failure(tmp_path):
    (cell,) = cells(("a",), ("robosuite/Lift",))
    rows = [row(cell, 0), row(cell, 1, "failure", failure="dropped")]
    folder = run_folder(tmp_path / "run", document(2, [cell]), rows)
    for seed in (0, 1):
        save_video(folder, cell, seed)
    page = write_report(folder).paths.html.read_text()
    assert "</span> failure: dropped, seed 1</figcaption>" in page
    assert "</span> success, seed 0</figcaption>" in page
    assert 'aria-label="failure: dropped of a on robosuite/Lift, seed 1"' in page


def test_new_failures_are_the_mildest_recorded_ones_of_each_simulator_and_not_of_the_gate(folder):
    for task in TASKS:
        save_video(folder, cell_of("experts", task, BLUR4), 0)
        save_video(folder, cell_of("oracle", task, BLUR4), 0)
    save_video(folder, cell_of("experts", TASKS[0], BLUR2), 2)
    found = media(folder).new_failures
    assert {(v.policy, v.task, v.condition, v.seed) for v in found} == {
        ("experts", TASKS[0], BLUR2, 2),
        ("experts", TASKS[1], BLUR4, 0),
    }


def test_typical_videos_come_before_those_of_new_failures(folder):
    save_video(folder, cell_of("experts", TASKS[0], CLEAN), 0, size=800)
    save_video(folder, cell_of("experts", TASKS[0], BLUR2), 0, size=150)
    found = media(folder, budget=1000)
    assert {v.status: v.source is not None for v in found.representative} == {"success": True, "failure": True}
    assert [v.source is not None for v in found.new_failures] == [False]
    assert found.left_out == 1


def test_a_strip_holds_the_clean_snapshot_and_one_for_each_severity(folder):
    for shade, condition in enumerate((CLEAN, BLUR2, BLUR4)):
        save_snapshot(folder, TASKS[0], condition, 90 * shade)
    strips = media(folder).strips
    assert list(strips) == ["blur"]
    assert [(s.task, [x.condition for x in s.snapshots]) for s in strips["blur"]] == [(TASKS[0], [CLEAN, BLUR2, BLUR4])]


def test_an_axis_that_shows_nothing_has_no_strip(folder):
    for condition in (CLEAN, BLUR2, BLUR4):
        save_snapshot(folder, TASKS[0], condition, 50)
    save_snapshot(folder, TASKS[1], BLUR2, 60)  # without a clean one to compare it with
    assert media(folder).strips == {}


def test_a_video_that_policies_share_is_embedded_once_and_linked_from_each(tmp_path):
    plan = cells(("experts", "merged", "other"), TASKS)
    shared = [row(cell, 0, actions_hash="same" if cell.policy != "other" else "else") for cell in plan]
    folder = run_folder(tmp_path / "shared", document(1, plan), shared)
    merged = next(cell for cell in plan if (cell.policy, cell.task) == ("merged", TASKS[0]))
    save_video(folder, merged, 0)
    page = write_report(folder).paths.html.read_text()
    shown = next(cell for cell in plan if (cell.policy, cell.task) == ("experts", TASKS[0])).episode(0).id
    assert page.count("data:video/mp4") == page.count(f'<video id="video-{shown}"') == 1
    assert page.count(f'<a class="absent" href="#video-{shown}">acts as<br>experts</a>') == 1
    found = collect_media(folder, document(1, plan), read_frame(folder / "episodes.parquet")).representative
    assert [(video.policy, video.path.stem) for video in found] == [
        ("experts", merged.episode(0).id),
        ("merged", merged.episode(0).id),
    ]


class Pictures(HTMLParser):
    """Alternative texts of pictures, and labels of videos."""

    def __init__(self, page):
        super().__init__()
        self.names = []
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        if tag in ("img", "video"):
            self.names.append(dict(attrs).get("alt") or dict(attrs).get("aria-label"))


def test_the_page_shows_strips_and_new_failures_with_their_axis(folder):
    save_snapshot(folder, TASKS[0], CLEAN, 10)
    save_snapshot(folder, TASKS[0], BLUR2, 80)
    save_video(folder, cell_of("experts", TASKS[0], BLUR2), 1)
    page = write_report(folder).paths.html.read_text()
    names = Pictures(page[page.index('id="axis-blur"') : page.index('id="gallery"')]).names
    assert names[:2] == [f"{TASKS[0]}: clean", f"{TASKS[0]}: 2: 0.6 % of image width"]
    assert names[2:] == [f"failure of experts on {TASKS[0]}, seed 1"]
    assert "Recorded failures of episodes that succeed under the clean condition: 1<" in page


def test_a_report_is_written_despite_a_broken_snapshot(folder):
    save_snapshot(folder, TASKS[0], CLEAN, 10)
    path = snapshot_path(folder, TASKS[0], BLUR2)
    path.write_bytes(b"\x89PNG\r\n\x1a\nbroken")
    assert [x.condition for x in media(folder).strips["blur"][0].snapshots] == [CLEAN]


def test_links_out_of_the_run_folder_are_not_embedded(folder, tmp_path):
    cell = cell_of("experts", TASKS[0], CLEAN)
    save_video(folder, cell, 0)
    save_snapshot(folder, TASKS[0], CLEAN, 10)
    save_snapshot(folder, TASKS[0], BLUR2, 20)
    assert media(folder).representative
    assert media(folder).strips
    for path in (video_path(folder, cell.episode(0).id), snapshot_path(folder, TASKS[0], BLUR2)):
        path.rename(tmp_path / path.name)
        path.symlink_to(tmp_path / path.name)
    assert not media(folder).representative
    assert not media(folder).strips.get("blur")


def test_the_gallery_comes_after_the_findings_and_is_open_while_it_is_short(folder):
    save_video(folder, cell_of("experts", TASKS[0], CLEAN), 0)
    page = write_report(folder).paths.html.read_text()
    assert page.index('class="findings"') < page.index(' maps"') < page.index('id="gallery"')
    assert '<details class="fold" open><summary>' in page


def test_a_long_gallery_is_folded(tmp_path):
    tasks = tuple(f"maniskill/T{number}" for number in range(10))
    plan = cells(("experts",), tasks)
    run = run_folder(tmp_path / "run", document(1, plan), [row(cell, 0) for cell in plan])
    for cell in plan:
        save_video(run, cell, 0)
    page = write_report(run).paths.html.read_text()
    assert '<details class="fold"><summary>10 tasks, 10 videos<' in page
