"""write_report writes files that agree, whatever the state of the run."""

from __future__ import annotations

import dataclasses
import json
import re
import time
from html.parser import HTMLParser
from io import BytesIO

import imageio_ffmpeg
import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image

from robogauntlet.results.record import FIELDS, describe_fields
from robogauntlet.results.report import ReportPaths, summary_model, write as module, write_report
from robogauntlet.results.report.media import collect_media, last_frame, task_picture
from robogauntlet.results.report.parquet import read_frame
from robogauntlet.results.report.templates import table_script
from robogauntlet.results.run_document import Provenance, RunError, RunStatus
from robogauntlet.results.run_owner import MARK_FILE
from robogauntlet.results.store.episode_store import StoreError
from robogauntlet.suites.episode import Condition, Perturbation
from tests.results.synthetic import cells, document, row, rows, run_folder, tables_of

HOSTILE = "<script>alert('x')</script>"


class Page(HTMLParser):
    """What a browser would fetch or run."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.fetched, self.text, self._in = [], [], "", []
        self.videos, self.scripts = [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        self.tags.append(tag)
        self.fetched += [values[name] for name in ("src", "poster", "srcset", "data", "action") if name in values]
        if tag in ("a", "link"):
            self.fetched.append(values.get("href", ""))
        if tag == "video":
            self.videos.append(values)
        assert not [name for name in values if name.startswith("on")]
        if tag in ("style", "script"):
            self._in.append(tag)

    def handle_endtag(self, tag):
        if self._in and tag == self._in[-1]:
            self._in.pop()

    def handle_data(self, data):
        if not self._in:
            self.text += data
        elif self._in[-1] == "script":
            self.scripts.append(data)


def assert_self_contained(text):
    page = Page(text)
    assert page.scripts == [table_script().text]
    assert all(value.startswith(("data:", "#")) for value in page.fetched)
    bare = re.sub(r"data:[a-z/0-9]+;base64,[A-Za-z0-9+/=]+", "", text)
    assert not re.search(r"https?:|//|url\(|@import", bare)


def report(tmp_path, run=None, results=None):
    folder = run_folder(tmp_path / "run", run or document(4), rows(planned=4, errors=1) if results is None else results)
    return write_report(folder).paths


def save_video(folder, result, frames=12, colour=(10, 200, 30), name=None):
    path = folder / "media" / "videos" / f"{name or result.episode_id}.mp4"
    path.parent.mkdir(parents=True, exist_ok=True)
    writer = imageio_ffmpeg.write_frames(str(path), (64, 64), fps=20, codec="libx264", ffmpeg_log_level="error")
    writer.send(None)
    for number in range(frames):
        shade = colour if number == frames - 1 or number > frames - 4 else (0, 0, 0)
        writer.send(np.full((64, 64, 3), shade, np.uint8).tobytes())
    writer.close()
    return path


def save_picture(folder, task, content=None):
    path = folder / "media" / "pictures" / f"{task.replace('/', '__')}.png"
    path.parent.mkdir(parents=True, exist_ok=True)
    if content is None:
        Image.new("RGB", (256, 256), (1, 2, 3)).save(path)
    else:
        path.write_bytes(content)


def test_a_report_is_five_files_and_nothing_is_printed(tmp_path, capsys):
    paths = report(tmp_path)
    assert paths == ReportPaths.in_folder(tmp_path / "run")
    names = {path.name for path in (tmp_path / "run").iterdir()}
    written = {"report.html", "report.md", "summary.json", "episodes.parquet", "cells.csv"}
    assert names == written | {"run.json", "episodes.sqlite", MARK_FILE}
    assert capsys.readouterr() == ("", "")


def test_parquet_has_every_row_and_every_field_with_its_sentence(tmp_path):
    results = rows(planned=4, errors=1)
    results[1] = dataclasses.replace(results[1], path_length=1.25, contact_steps=3, failure="dropped")
    table = pq.read_table(report(tmp_path, results=results).episodes)
    assert table.schema.names == list(FIELDS)
    for name, (_, nullable, sentence) in describe_fields().items():
        assert table.schema.field(name).metadata[b"description"].decode() == sentence
        assert table.schema.field(name).nullable == nullable
    assert table.schema.metadata[b"run_id"] == b"run-1"
    stored = sorted((tuple(line[name] for name in FIELDS) for line in table.to_pylist()), key=str)
    assert stored == sorted((tuple(getattr(r, name) for name in FIELDS) for r in results), key=str)


def test_parquet_is_written_in_pieces(tmp_path, monkeypatch):
    monkeypatch.setattr("robogauntlet.results.store.episodes_parquet.BATCH", 10)
    file = pq.ParquetFile(report(tmp_path).episodes)
    assert [file.metadata.row_group(i).num_rows for i in range(file.metadata.num_row_groups)] == [10, 10, 10, 2]


def test_the_summary_file_follows_its_model(tmp_path):
    run, results = document(4), rows(planned=4, errors=1)
    content = report(tmp_path, run, results).summary.read_text()
    summary = summary_model().model_validate_json(content)
    tables = tables_of(run, results)
    assert summary.total == tables.total
    assert summary.cells == tables.cells
    assert summary.policies == tables.by_policy
    assert (summary.format, summary.confidence, summary.error_messages) == (1, 0.95, 1)
    assert "NaN" not in content


def test_the_shape_of_the_summary_is_stable():
    """Programs read this file: adding a field is fine (add it here), renaming or removing one needs a new `format`."""
    schema = summary_model().model_json_schema()
    assert " ".join(sorted(schema["properties"])) == (
        "answers behaviour benchmark cells combinations confidence elapsed_s episodes_per_hour error_messages errors "
        "failures findings finished_at format latency merging not_run pairwise policies policy_digests provenance "
        "reason render_devices robots robustness routing rows_hash run_id shared_workers simulators skipped "
        "started_at status success_rule suite_hash suite_name timing total workers"
    )
    assert " ".join(sorted(schema["$defs"]["Tally"]["properties"])) == (
        "bounds done errors failures interval mean_seconds mean_steps missing planned rate success_once successes"
    )


def test_the_page_fetches_nothing_and_runs_nothing(tmp_path):
    folder = run_folder(tmp_path / "run", document(4), results := rows(planned=4))
    save_video(folder, results[0])
    save_picture(folder, results[0].task)
    assert_self_contained(write_report(folder).paths.html.read_text())


@pytest.mark.parametrize(
    ("place", "changes"),
    [
        ("policy", {}),
        ("task", {}),
        ("suite", {"description": HOSTILE, "suite_text": HOSTILE, "suite_path": HOSTILE}),
        ("error", {}),
        ("instruction", {"instructions": {"a/b": HOSTILE}}),
        ("reason", {"reason": HOSTILE}),
        ("package", {"provenance": Provenance(packages={HOSTILE: HOSTILE})}),
        ("skipped", {"skipped": {HOSTILE: HOSTILE}}),
    ],
)
def test_a_script_in_any_name_is_escaped(tmp_path, place, changes):
    names = {"policy": "oracle", "task": "a/b", "error": "broken"} | {place: f"maniskill/{HOSTILE}"}
    plan = cells((names["policy"],), (names["task"],))
    run = document(3, plan, **changes)
    results = [row(plan[0], 0), row(plan[0], 1, "error", error=names["error"])]
    folder = run_folder(tmp_path / "run", run, results)
    save_picture(folder, "a/b")
    paths = write_report(folder).paths
    page = Page(paths.html.read_text())
    assert page.scripts == [table_script().text]
    assert HOSTILE in page.text
    assert "<script" not in paths.markdown.read_text()


def test_what_a_policy_asked_for_in_vain_is_at_the_top_of_both_reports(tmp_path):
    warning = "frames are rendered at 96 px and enlarged to 224 for policy 'pi0'; set image_size: 224"
    plan = cells(("pi0",))
    folder = run_folder(tmp_path / "run", document(2, of=plan, warnings=(warning,)), rows(plan, 2))
    write_report(folder)
    assert f"**Warning**: {warning}." in (folder / "report.md").read_text().replace("\\", "")
    page = (folder / "report.html").read_text()
    assert "enlarged to 224" in page[: page.index("<nav")]


def test_an_interrupted_run_still_gives_a_readable_report(tmp_path):
    run = document(4, status=RunStatus.INTERRUPTED, reason="Ctrl-C", skipped={"robosuite": "not installed here"})
    results = [result for result in rows(planned=4) if result.simulator != "robosuite" and result.seed < 2]
    paths = report(tmp_path, run, results)
    for text in (Page(paths.html.read_text()).text, paths.markdown.read_text()):
        assert "Interrupted" in text
        assert "12 of 32 episodes done" in text
        assert "not installed here" in text
        assert "run interrupted: Ctrl-C" in text
        assert "maniskill/PushCube-v1" in text


@pytest.mark.parametrize("status", list(RunStatus))
def test_the_report_of_a_run_without_rows_states_it(tmp_path, status):
    paths = report(tmp_path, document(4, status=status, elapsed_s=0.0), [])
    assert "This run has no results yet" in Page(paths.html.read_text()).text
    assert "This run has no results yet" in paths.markdown.read_text()
    assert pq.read_table(paths.episodes).num_rows == 0
    assert summary_model().model_validate_json(paths.summary.read_text()).total.missing == 32


def test_errors_come_with_the_command_that_replays_them(tmp_path):
    page = Page(report(tmp_path).html.read_text())
    example = cells()[0].episode(0).id
    assert f"robogauntlet replay {example} --run {tmp_path / 'run'}" in page.text
    assert "WorkerDied: signal 9" in page.text


def test_a_report_is_replaced_as_a_whole_or_not_at_all(tmp_path, monkeypatch):
    paths = report(tmp_path)
    before = {path: path.read_bytes() for path in (paths.html, paths.markdown, paths.summary, paths.episodes)}

    def broken(*_):
        raise OSError("disk full")

    monkeypatch.setattr(module, "write_parquet", broken)
    with pytest.raises(OSError, match="disk full"):
        write_report(tmp_path / "run")
    assert {path: path.read_bytes() for path in before} == before
    assert not [path for path in (tmp_path / "run").iterdir() if path.name.startswith(".")]


def test_a_report_can_be_written_again(tmp_path):
    first = report(tmp_path).html.read_text()
    assert write_report(tmp_path / "run").paths.html.read_text() == first


def test_a_folder_that_is_no_run_is_refused(tmp_path):
    with pytest.raises(RunError, match=r"it has no run\.json"):
        write_report(tmp_path)
    folder = run_folder(tmp_path / "run", document(1), [])
    (folder / "episodes.sqlite").write_text("something else, and long enough to be no database header")
    with pytest.raises(StoreError, match="something else"):
        write_report(folder)


def test_a_wrong_store_leaves_the_report_unchanged_and_creates_nothing(tmp_path):
    before = report(tmp_path).html.read_bytes()
    with pytest.raises(StoreError, match="/run, there is no such file"):
        write_report(tmp_path / "run", store_url=f"sqlite:///{tmp_path / 'mistyped.sqlite'}")
    run_folder(tmp_path / "other", document(1, run_id="another"), rows(planned=1))
    with pytest.raises(StoreError, match="it has nothing of this run"):
        write_report(tmp_path / "run", store_url=f"sqlite:///{tmp_path / 'other' / 'episodes.sqlite'}")
    (tmp_path / "run" / "episodes.sqlite").unlink()
    with pytest.raises(StoreError, match="there is no such file"):
        write_report(tmp_path / "run")
    assert (tmp_path / "run" / "report.html").read_bytes() == before
    assert {path.name for path in tmp_path.iterdir()} == {"run", "other"}


def test_videos_are_the_first_recorded_success_and_failure(tmp_path):
    cell = cells()[0]
    results = [row(cell, seed, "success" if seed in (1, 3, 4) else "failure") for seed in range(6)]
    results.append(row(cell, 6, "error"))
    folder = run_folder(tmp_path / "run", document(7, [cell]), results)
    for result in (results[3], results[4], results[5], results[2], results[6]):
        save_video(folder, result)
    save_video(folder, None, name="0123456789abcdef")
    page = Page(write_report(folder).paths.html.read_text())
    shown = [(video["aria-label"].split(" of ")[0], video["aria-label"][-1]) for video in page.videos]
    assert shown == [("success", "3"), ("failure", "2")]
    for video in page.videos:
        assert video["preload"] == "none"
        assert {"muted", "loop", "controls"} <= set(video)
        assert video["src"].startswith("data:video/mp4;base64,")
        assert video["poster"].startswith("data:image/jpeg;base64,")


def test_the_smallest_videos_come_first_and_the_rest_is_counted(tmp_path):
    cell = cells()[0]
    results = [row(cell, 0), row(cell, 1, "failure")]
    run = document(2, [cell])
    folder = run_folder(tmp_path / "run", run, results)
    videos = folder / "media" / "videos"
    videos.mkdir(parents=True)
    (videos / f"{results[0].episode_id}.mp4").write_bytes(b"x" * 900)
    (videos / f"{results[1].episode_id}.mp4").write_bytes(b"x" * 200)
    found = collect_media(folder, run, read_frame(write_report(folder).paths.episodes), budget=1000).representative
    assert {video.status: video.source is not None for video in found} == {"failure": True, "success": False}
    page = Page(write_report(folder, video_budget=1000).paths.html.read_text())
    assert len(page.videos) == 1
    assert "1 video left out" in page.text


def test_a_report_is_written_despite_a_broken_picture_or_video(tmp_path):
    cell = cells()[0]
    folder = run_folder(tmp_path / "run", document(2, [cell]), [row(cell, 0), row(cell, 1, "failure")])
    save_picture(folder, cell.task, b"\x89PNG\r\n\x1a\nbroken")
    videos = folder / "media" / "videos"
    videos.mkdir(parents=True)
    (videos / f"{cell.episode(0).id}.mp4").write_bytes(b"broken")
    (videos / f"{cell.episode(1).id}.mp4").write_bytes(b"")
    page = Page(write_report(folder).paths.html.read_text())
    assert len(page.videos) == 1
    assert "poster" not in page.videos[0]
    assert task_picture(folder, cell.task) is None


def test_a_poster_is_the_last_frame_of_its_video(tmp_path):
    path = save_video(tmp_path, None, frames=30, colour=(10, 200, 30), name="x")
    red, green, blue = Image.open(BytesIO(last_frame(path))).convert("RGB").getpixel((32, 32))
    assert green > 150 > red
    assert blue < 100


def test_the_provenance_is_complete(tmp_path):
    made = Provenance(git_commit="c04b5f3", git_dirty=True, python="3.11.9", packages={"mujoco": "3.3.7"}, cores=4)
    changes = {"rows_hash": "feedbeef", "render_devices": {"robosuite": "OSMesa, CPU"}, "workers": {"robosuite": 3}}
    run = document(4, provenance=made, suite_text="name: synthetic # the file itself", **changes)
    paths = report(tmp_path, run)
    page = Page(paths.html.read_text()).text
    for text in (page, paths.markdown.read_text().replace("\\_", "_")):
        for fact in ("c04b5f3 with uncommitted changes", "3.11.9", "3.3.7", "OSMesa, CPU", "feedbeef", run.suite_hash):
            assert fact in text
        assert cells()[0].policy_digest in text
    assert "the file itself" in page
    assert json.loads(paths.summary.read_text())["provenance"]["git_dirty"] is True


def test_a_report_of_many_axes_and_combinations_is_written_in_seconds_and_says_what_it_leaves_out(tmp_path):
    pairs = [[Perturbation(f"{axis}-{number}", 2) for axis in ("left", "right")] for number in range(300)]
    conditions = (Condition(), *(Condition(f"axis-{n}", 1) for n in range(100)), *(Condition.of(*p) for p in pairs))
    plan, start = cells(["oracle"], ("maniskill/PushCube-v1",), conditions), time.process_time()
    paths = report(tmp_path, document(2, plan), rows(plan, planned=2))
    assert time.process_time() - start < 20
    sentence = "ailure clusters of two axes are left out, as there are more than 100 axes"
    assert sentence in paths.markdown.read_text()


def test_a_report_of_many_policies_is_written_in_seconds_and_says_what_it_leaves_out(tmp_path):
    names = [f"step-{number}" for number in range(200)]
    plan, start = cells(names, ("maniskill/PushCube-v1",)), time.process_time()
    paths = report(tmp_path, document(1, plan, policies=names), rows(plan, planned=1))
    assert time.process_time() - start < 20
    for file in (paths.markdown, paths.html):
        assert "Pairs and letters of more than 100 policies are left out." in file.read_text()
