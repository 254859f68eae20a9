"""A run as an archive or a folder: it comes back as it was, and what is none is refused in one line."""

import os
import shutil
import stat
import zipfile
from contextlib import closing
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory

import pyarrow as pa
import pytest
from hypothesis import given, settings, strategies as st

from robogauntlet.results.media_paths import picture_path, snapshot_path, video_path
from robogauntlet.results.record import WAITING, FailureKind, outcome_row, rows_hash
from robogauntlet.results.run_document import RunError, RunStatus, read_run, store_url
from robogauntlet.results.store import exported_files, exported_run
from robogauntlet.results.store.arriving import arriving_folder
from robogauntlet.results.store.database import StoreError
from robogauntlet.results.store.episode_store import Store
from robogauntlet.results.store.exported_run import export_run, import_run
from robogauntlet.suites.episode import Condition
from tests.bad_input.forged import exported_row, exported_rows, exported_table, exported_with, packed, rewritten
from tests.errors import one_line_error
from tests.results.synthetic import cells, document, row, rows, run_folder

RUN_ID = "0123456789abcdef0123456789abcdef"
RESULTS = rows(planned=4, errors=1)


def export(root, name="night.zip", results=RESULTS, *, media=False, **changes):
    """An exported run of these rows."""
    values = {"run_id": RUN_ID, "rows_hash": rows_hash(map(outcome_row, results)), **changes}
    run = document(values.pop("planned", 4), **values)
    folder = run_folder(root / "runs" / "night", run, results)
    if media:
        write_media(folder)
    with closing(Store.open(store_url(folder, run), run.run_id)) as store:
        assert export_run(folder, run, store, root / name, media=media) == len(results)
    return root / name


def write_media(folder):
    snapshot = snapshot_path(folder, RESULTS[0].task, Condition("noise", 3))
    for path in (video_path(folder, RESULTS[0].episode_id), picture_path(folder, RESULTS[0].task), snapshot):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(path.name.encode())


@cache
def sound():
    with TemporaryDirectory() as root:
        return export(Path(root)).read_bytes()


@pytest.fixture
def file(tmp_path):
    """An exported run of `RESULTS`."""
    path = tmp_path / "night.zip"
    path.write_bytes(sound())
    return path


def stored(folder):
    run = read_run(folder)
    with closing(Store.open(store_url(folder, run), run.run_id)) as store:
        return sorted(store.results(), key=lambda r: r.episode_id)


def paths(folder):
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())


def refuse(file, match):
    """Expects that the file is refused in one line and leaves nothing."""
    with one_line_error(RunError, match) as caught:
        import_run(file, file.parent / "there")
    assert str(caught.value).startswith(f"{file}: ")
    assert len(str(caught.value)) < 500
    assert not (file.parent / "there").exists()


@pytest.mark.parametrize("name", ["night.zip", "night"])
def test_a_run_comes_back_as_it_was(tmp_path, name):
    folder, run = import_run(export(tmp_path, name), tmp_path / "there")
    assert read_run(folder) == run
    assert run == read_run(tmp_path / "runs" / "night").model_copy(update={"origin": "imported"})
    assert stored(folder) == sorted(RESULTS, key=lambda r: r.episode_id)
    assert rows_hash(map(outcome_row, stored(folder))) == run.rows_hash
    assert [path.name for path in (tmp_path / "there").iterdir()] == [folder.name]
    assert paths(folder) == ["episodes.sqlite", "run.json"]


def test_a_run_of_an_earlier_version_comes_back_without_the_columns_that_it_lacks(file):
    file.write_bytes(exported_table(lambda table: table.drop_columns(["timing", *WAITING]), sound()))
    assert stored(import_run(file, file.parent / "there")[0]) == sorted(RESULTS, key=lambda r: r.episode_id)


def test_measured_behaviour_comes_back_with_every_kind_of_failure(tmp_path):
    numbers = {"path_length": 0.0, "smoothness": -12.5, "progress": -1.0, "contact_steps": 100, "contact_force": 3.5}
    failed = [row(cells()[0], 5 + n, "failure", failure=str(kind), **numbers) for n, kind in enumerate(FailureKind)]
    won = row(cells()[0], 0, time_to_success=1.25, gripper_openings=1, joint_limit_steps=0, routing_scores='{"a": 0.5}')
    results = [*failed, won, row(cells()[0], 1, "error")]
    folder, _ = import_run(export(tmp_path, results=results), tmp_path / "there")
    assert stored(folder) == sorted(results, key=lambda r: r.episode_id)


def test_an_archive_holds_the_document_and_the_rows(file):
    assert zipfile.ZipFile(file).namelist() == ["run.json", "episodes.parquet"]


@pytest.mark.parametrize("name", ["night.zip", "night"])
def test_videos_and_pictures_go_with_the_run_if_wanted(tmp_path, name):
    folder, _ = import_run(export(tmp_path, name, media=True), tmp_path / "there")
    task, episode = RESULTS[0].task.replace("/", "__"), RESULTS[0].episode_id
    media = [f"media/pictures/{task}.png", f"media/snapshots/{task}@noise@3.png", f"media/videos/{episode}.mp4"]
    assert paths(folder) == ["episodes.sqlite", *media, "run.json"]
    assert (folder / media[2]).read_text() == f"{episode}.mp4"


def test_links_to_files_elsewhere_are_not_exported(tmp_path):
    (tmp_path / "secret.mp4").write_text("secret")
    folder = tmp_path / "runs" / "night"
    video_path(folder, "a").parent.mkdir(parents=True)
    video_path(folder, "a").symlink_to(tmp_path / "secret.mp4")
    archive = export(tmp_path, media=True)
    assert not any("a.mp4" in name.split("/") for name in zipfile.ZipFile(archive).namelist())


def test_an_import_takes_no_other_file_of_a_folder(tmp_path):
    folder = export(tmp_path, "night", media=True)
    (folder / "report.html").write_text("theirs")
    (folder / "media" / "videos" / "run.sh").write_text("theirs")
    imported, _ = import_run(folder, tmp_path / "there")
    assert {Path(name).suffix for name in paths(imported)} == {".sqlite", ".json", ".mp4", ".png"}


def test_existing_runs_and_files_are_not_overwritten(file, tmp_path):
    import_run(file, tmp_path / "there", name="one")
    with pytest.raises(RunError, match="there is one already"):
        import_run(file, tmp_path / "there", name="one")
    with closing(Store.open_file(tmp_path / "any.sqlite", "run-1")) as store:
        for target in (file, tmp_path / "there"):
            with pytest.raises(RunError, match="there is one already"):
                export_run(tmp_path, document(), store, target)
    assert file.read_bytes() == sound()


@pytest.mark.parametrize("name", ["night.zip", "night"])
def test_an_export_that_fails_leaves_nothing(tmp_path, monkeypatch, name):
    def broken(*_):
        raise StoreError("the rows are gone")

    monkeypatch.setattr(exported_run, "write_parquet", broken)
    with pytest.raises(StoreError):
        export(tmp_path, name)
    assert [path.name for path in tmp_path.iterdir()] == ["runs"]


def test_the_origin_and_the_command_are_not_the_senders_to_choose(tmp_path):
    _, run = import_run(export(tmp_path, origin="local", command="rm -r /"), tmp_path / "there")
    assert (run.origin, run.command, run.store_url) == ("imported", None, None)


@pytest.mark.parametrize("run_id", ["../up", "run-1", "0" * 31, "0" * 33, "A" * 32, "x" * 499])
def test_a_run_id_that_this_program_does_not_make_is_refused(tmp_path, run_id):
    refuse(export(tmp_path, run_id=run_id, status=RunStatus.INTERRUPTED), "its run id is not one of this program")


def test_what_dead_processes_left_is_removed_and_what_others_hold_is_not(file, tmp_path):
    root = tmp_path / "there"
    (root / ".arriving-dead").mkdir(parents=True)
    (root / ".arriving-dead" / "body").write_bytes(b"half of a run")
    with arriving_folder(root) as alive:
        for folder in root.glob(".arriving-*"):
            os.utime(folder, (1.0, 1.0))
        (root / ".arriving-young").mkdir()
        import_run(file, root)
        assert {path.name for path in root.glob(".arriving-*")} == {alive.name, ".arriving-young"}


def linked(name):
    entry = zipfile.ZipInfo(name)
    entry.external_attr = (stat.S_IFLNK | 0o777) << 16
    return entry


def with_file(name, good, content=b"x"):
    return rewritten(good, {name: content})


FILES = {
    "text": (lambda good: b"name: something else\n" * 100, "this is something else, or damaged"),
    "empty": (lambda good: b"", "this is something else, or damaged"),
    "cut": (lambda good: good[: len(good) // 2], "this is something else, or damaged"),
    "backwards": (lambda good: good[::-1], "this is something else, or damaged"),
    "a damaged document": (lambda good: good[:100] + b"\xff" * 100 + good[200:], "it is damaged"),
    "no document": (lambda good: rewritten(good, {"run.json": None}), "it has no run.json"),
    "no rows": (lambda good: rewritten(good, {"episodes.parquet": None}), "it has no episodes.parquet"),
    "a path out": (partial(with_file, "../up.mp4"), r"it has a file '../up.mp4' too many"),
    "a path out of the media": (partial(with_file, "media/videos/../../up.mp4"), "too many"),
    "an absolute path": (partial(with_file, "/etc/x.mp4"), "too many"),
    "a script": (partial(with_file, "media/videos/run.sh"), "too many"),
    "a page": (partial(with_file, "report.html"), "too many"),
    "a name with a colour": (partial(with_file, "media/videos/\x1b[31m.mp4"), r"\\x1b\[31m.mp4' too many"),
    "a link": (lambda good: rewritten(good, {linked("media/videos/a.mp4"): b"/etc/passwd"}), "a link or no file"),
    "a link for rows": (
        lambda good: packed([("run.json", b"{}"), (linked("episodes.parquet"), b"/etc/passwd")]),
        "its episodes.parquet is a link or no file",
    ),
    "rows that are none": (partial(with_file, "episodes.parquet", content=b"PAR1" * 99), "it is damaged"),
    "rows of nothing": (partial(with_file, "episodes.parquet", content=b""), "it is damaged"),
    "a document of nothing": (partial(with_file, "run.json", content=b""), "expected a run document of format 1"),
    "a document in another code": (partial(with_file, "run.json", content=b"\xff\xfe{"), "expected a run document"),
}


@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.parametrize(("change", "words"), FILES.values(), ids=FILES)
def test_what_is_no_exported_run_is_refused(file, change, words):
    file.write_bytes(change(sound()))
    refuse(file, words)


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_a_file_that_is_there_twice_is_refused(file):
    with zipfile.ZipFile(file, "a") as archive:
        archive.writestr("run.json", "{}")
    refuse(file, "it has a file 'run.json' too many")


def test_a_file_that_unfolds_beyond_its_bound_is_refused_before_it_is_unpacked(file, monkeypatch):
    monkeypatch.setitem(exported_files.LARGEST, "episodes.parquet", 1000)
    refuse(file, "its episodes.parquet is larger than 1,000 bytes")


def test_a_file_is_not_unpacked_beyond_the_size_that_its_archive_declares(file):
    """The declared size is what is compared with the bound."""
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("run.json", bytes(10_000_000))
        archive.writestr("episodes.parquet", b"")
    large, small = (size.to_bytes(4, "little") for size in (10_000_000, 1000))
    assert file.read_bytes().count(large) == 2
    file.write_bytes(file.read_bytes().replace(large, small))
    refuse(file, "it is damaged")


def test_files_that_together_unfold_beyond_the_bound_are_refused(file, monkeypatch):
    with zipfile.ZipFile(file, "a", zipfile.ZIP_DEFLATED) as archive:
        for number in range(10):
            archive.writestr(f"media/videos/{number}.mp4", bytes(10_000))
    monkeypatch.setattr(exported_files, "LARGEST_ARCHIVE", 100_000)
    refuse(file, "its files are together larger than 100,000 bytes")


@pytest.mark.parametrize("method", [zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2])
def test_other_methods_of_compression_are_refused(file, method):
    with zipfile.ZipFile(file, "w", method) as archive:
        archive.writestr("run.json", "{}")
    refuse(file, "encrypted, or compressed by another method")


def test_an_archive_beyond_its_bound_is_not_opened(file, monkeypatch):
    monkeypatch.setattr(exported_files, "LARGEST_ARCHIVE", 1000)
    refuse(file, "more than 1,000 bytes")


def test_a_folder_whose_files_are_none_is_refused(tmp_path):
    folder = export(tmp_path, "night")
    (folder / "run.json").unlink()
    refuse(folder, "run.json: No such file or directory")
    os.mkfifo(folder / "run.json")
    refuse(folder, "run.json: a named pipe, no regular file")
    shutil.rmtree(folder)
    refuse(folder, "No such file or directory")


HUGE = 2**63 - 1
VALUES = {
    "infinity": ({"reward_sum": float("inf")}, "reward_sum is no finite number"),
    "no number": ({"wall_s": float("nan")}, "wall_s is no finite number"),
    "negative": ({"seed": -1}, "seed is out of bounds"),
    "beyond 2^53": ({"steps": 2**53 + 1}, "steps is out of bounds"),
    "beyond all": ({"steps": HUGE}, "steps is out of bounds"),
    "long": ({"error": "x" * 200_000}, "error is too long"),
    "NUL": ({"error": "\0"}, "error is too long or has the character NUL"),
    "status": ({"status": "won"}, "its status or failure is unknown"),
    "failure": ({"failure": "bored"}, "its status or failure is unknown"),
    "profile": ({"render_profile": "none"}, "its protocol is unknown"),
    "protocol of nobody": ({"protocol": "none"}, "its protocol is unknown"),
    "another seed": ({"seed": 99}, "its id is not that of its episode"),
    "another pair": ({"pair_id": "x"}, "its id is not that of its episode"),
    "another episode": ({"episode_id": "x" * 16}, "its id is not that of its episode"),
    "another simulator": ({"simulator": "x"}, "its id is not that of its episode"),
    "another task": ({"task": "null/Reach"}, "it is not planned"),
    "another policy": ({"policy_digest": "x"}, "it is not planned"),
    "huge images": ({"image_size": 1_000_000}, "its protocol is not that of the suite"),
    "another protocol": ({"protocol": "openvla"}, "its protocol is not that of the suite"),
    "its own protocol by name": ({"protocol": "robogauntlet"}, "its id is not that of its episode"),
    "another rule of success": ({"success_rule": "once"}, "its protocol is not that of the suite"),
    "endless": ({"horizon": 10**9}, "horizon is out of bounds"),
    "scores": ({"routing_scores": "[]"}, "routing_scores are no scores by name"),
    "half of scores": ({"routing_scores": "["}, "routing_scores are no scores by name"),
    "nested scores": ({"routing_scores": "[" * 90_000}, "routing_scores are no scores by name"),
    "another measurement": ({"path_length": 1.0}, "they were changed"),
    "another outcome": ({"steps": 7}, "they were changed"),
}


@pytest.mark.parametrize(("values", "words"), VALUES.values(), ids=VALUES)
def test_a_row_that_this_program_did_not_write_is_refused(file, values, words):
    file.write_bytes(exported_row(sound(), **values))
    refuse(file, words)


TABLES = {
    "a row less": (partial(exported_rows, lambda rows: rows.pop()), "they were changed"),
    "no row": (partial(exported_rows, lambda rows: rows.clear()), "they were changed"),
    "a row twice": (
        partial(exported_rows, lambda rows: rows.__setitem__(0, dict(rows[1]))),
        "an episode is there twice",
    ),
    "a row too many": (
        partial(exported_rows, lambda rows: rows.append(rows[0])),
        "it has 33 rows, the run 32 episodes",
    ),
    **{
        name: (partial(exported_table, change), "its columns are not")
        for name, change in {
            "a column less": lambda table: table.drop_columns(["failure"]),
            "a column more": lambda table: table.append_column("x", pa.nulls(len(table))),
            "columns in another order": lambda table: table.select(table.column_names[::-1]),
            "text for numbers": lambda table: table.set_column(12, "steps", table["status"]),
        }.items()
    },
}


@pytest.mark.parametrize(("change", "words"), TABLES.values(), ids=TABLES)
def test_a_table_that_is_not_that_of_the_run_is_refused(file, change, words):
    file.write_bytes(change(sound()))
    refuse(file, words)


DOCUMENTS = {
    "no hash": ("rows_hash", None, "expected a hash of the rows of a complete run, it has none"),
    "another hash": ("rows_hash", "0" * 16, "these hash to .*: they were changed"),
    "a path as id": ("run_id", "../../x", "its run id is not one of this program"),
    "a time": ("started_at", 1e20, "started_at"),
    "a type": ("started_at", "yesterday", "started_at"),
    "a text for a plan": ("plan", "all", "plan"),
    "no number": ("elapsed_s", float("nan"), "elapsed_s"),
    "a plan without end": ("plan:0:planned", 2**63, "planned"),
    "a severity below 0": ("plan:0:severity", -1, "severity"),
    "a long policy": ("plan:0:policy", "x" * 3_000_000, "expected a run document"),
    "a key": ("\x1b[31m" * 1000, 1, "expected a run document"),
    "another policy": ("plan:0:policy_digest", "other", "a row is not one of this program: it is not planned"),
    "small images": ("suite:image_size", 32, "its protocol is not that of the suite"),
}


@pytest.mark.parametrize(("place", "value", "words"), DOCUMENTS.values(), ids=DOCUMENTS)
def test_a_document_that_this_program_did_not_write_is_refused(file, place, value, words):
    file.write_bytes(exported_with(place, value, sound()))
    refuse(file, words)


def test_a_plan_of_mistakes_makes_no_list_of_them(file):
    file.write_bytes(exported_with("plan", [{}] * 1000, sound()))
    with pytest.raises(RunError) as caught:
        import_run(file, file.parent / "there")
    assert len(caught.value.__context__.errors()) == 7  # those of one cell


def test_the_rows_of_a_large_run_are_read_in_parts(file, monkeypatch):
    monkeypatch.setattr(exported_run, "BATCH", 7)
    folder, _ = import_run(file, file.parent / "there")
    assert stored(folder) == sorted(RESULTS, key=lambda r: r.episode_id)


@settings(max_examples=150)
@given(data=st.data())
def test_flipped_bytes_are_a_run_or_an_error_of_one_line(data):
    content = bytearray(sound())
    for place, value in data.draw(
        st.lists(st.tuples(st.integers(0, len(content) - 1), st.integers(0, 255)), min_size=1, max_size=20)
    ):
        content[place] = value
    length = data.draw(st.one_of(st.just(len(content)), st.integers(1, len(content))))
    with TemporaryDirectory() as folder:
        file = Path(folder) / "night.zip"
        file.write_bytes(bytes(content[:length]))
        message = ""
        try:
            import_run(file, Path(folder) / "there")
        except (RunError, StoreError) as error:
            message = str(error)
        assert "\n" not in message
