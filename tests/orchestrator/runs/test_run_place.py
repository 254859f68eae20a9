"""A run whose folder goes while it plays."""

import shutil
from contextlib import closing

import pytest

from robogauntlet.orchestrator.runs.plan import make_plan
from robogauntlet.orchestrator.runs.run_document import create_or_continue
from robogauntlet.orchestrator.runs.run_place import RunPlace
from robogauntlet.results.run_document import RunStatus, read_run
from robogauntlet.results.store.database import StoreError
from robogauntlet.results.store.episode_store import Store, file_url
from robogauntlet.results.store.run_history import History
from tests.orchestrator.runs.playing import SUITE, Run, observer, rows_of
from tests.results.synthetic import row


@pytest.fixture
def place(run, suite):
    """The place of a run with one row; it is closed afterwards."""

    def begin(url=None):
        plan = make_plan(suite())
        run.folder.mkdir()
        document = create_or_continue(plan, run.folder, url)
        document = document.model_copy(update={"command": f"robogauntlet run '{plan.path}' --out '{run.folder}' --x"})
        begun.append(RunPlace(plan, run.folder, document, url))
        History(begun[0].store.database).record(document, run.folder)
        begun[0].add([row(plan.cells[0], 0)])
        return begun[0], document, plan.cells[0]

    begun = []
    yield begin
    for one in begun:
        one.store.close()


def remove(folder):
    shutil.rmtree(folder)


def rename(folder):
    folder.rename(folder.with_name("elsewhere"))


def replace(folder):
    rename(folder)
    folder.mkdir()
    (folder / "run.json").write_text("mine")


def remove_its_store(folder):
    for path in folder.glob("episodes.sqlite*"):
        path.unlink()


@pytest.mark.parametrize("fault", [remove, rename, replace, remove_its_store])
def test_all_rows_are_saved_in_a_new_folder_and_the_run_is_stopped(place, run, fault):
    here, document, cell = place()
    (run.folder.parent / "run-saved").write_text("mine")
    fault(run.folder)
    with pytest.raises(StoreError, match="run: removed, renamed or replaced while the run plays"):
        here.add([row(cell, 1)])
    saved = here.save_beside(document)
    folder = run.folder.with_name("run-saved1")
    assert (here.folder, here.is_lost, saved) == (folder, False, read_run(folder))
    assert saved.status is RunStatus.STOPPED
    assert saved.reason.endswith(f"was removed, renamed or replaced while the run played; all of it is in {folder}")
    assert saved.command.endswith(f"--out {folder} --x")
    assert [one.seed for one in rows_of(folder)] == [0, 1]
    assert fault is not replace or (run.folder / "run.json").read_text() == "mine"


def test_a_store_elsewhere_stays_where_it_is(place, run, tmp_path):
    url = file_url(tmp_path / "all.sqlite")
    here, document, _ = place(url)
    shutil.rmtree(run.folder)
    saved = here.save_beside(document)
    assert (saved.store_url, here.url) == (url, url)
    assert not (here.folder / "episodes.sqlite").exists()
    with closing(Store.open_begun(here.folder, saved, url)) as store:
        assert store.has_rows()


@pytest.mark.ray
@pytest.mark.usefixtures("ray_here")
def test_a_run_that_lost_its_folder_is_stopped_and_continued_where_it_was_saved(run, suite, tmp_path):
    path = suite(SUITE.replace("Reach", "Slow").replace("count: 20", "count: 5"))
    lose = observer(on_rows=lambda rows: shutil.rmtree(run.folder, ignore_errors=True))
    outcome = run(path, observers=[lose])
    assert outcome.document.status is RunStatus.STOPPED
    assert 0 < outcome.done < 10
    assert outcome.folder == tmp_path / "run-saved"
    assert outcome.report.paths.html == outcome.folder / "report.html"
    assert outcome.report.paths.html.exists()
    assert not run.folder.exists()
    outcome = Run(outcome.folder)(path)
    assert (outcome.document.status, outcome.done) == (RunStatus.COMPLETE, 10)
