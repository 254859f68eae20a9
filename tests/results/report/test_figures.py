"""The figures for a paper."""

import sys

import pytest
from PIL import Image

from robogauntlet.results.report import write_report
from robogauntlet.results.report.figure_style import COLUMN
from robogauntlet.results.report.figures import FigureFormat, check_matplotlib, write_figures
from robogauntlet.support.errors import BadInput
from tests.results.analysis import test_condition_comparison as perturbed
from tests.results.routed import routed_document, routed_rows
from tests.results.synthetic import cells, document, rows, run_folder


@pytest.fixture(scope="module")
def clean(tmp_path_factory):
    plan = cells(("$oracle_1", "random"))
    run = run_folder(tmp_path_factory.mktemp("clean") / "run", document(10, of=plan), rows(plan))
    return write_report(run)


@pytest.fixture(scope="module")
def under_noise(tmp_path_factory):
    run = document(perturbed.SEEDS, of=perturbed.PLAN, compare=perturbed.COMPARE)
    return write_report(run_folder(tmp_path_factory.mktemp("perturbed") / "run", run, perturbed.rows()))


@pytest.fixture(scope="module")
def routed(tmp_path_factory):
    return write_report(run_folder(tmp_path_factory.mktemp("routed") / "run", routed_document(), routed_rows()))


@pytest.mark.parametrize(("form", "start"), [(FigureFormat.SVG, b"<?xml"), (FigureFormat.PDF, b"%PDF")])
def test_the_plots_are_written_in_the_format_asked_for(clean, tmp_path, form, start):
    written = write_figures(clean, tmp_path, form)
    assert {path.suffix for path in written} == {f".{form}"}
    assert all(path.read_bytes().startswith(start) for path in written)


def test_every_plot_of_the_report_is_a_figure_as_wide_as_a_column(clean, under_noise, routed, tmp_path):
    for number, report in enumerate((clean, under_noise, routed)):
        page = report.paths.html.read_text()
        written = write_figures(report, tmp_path / str(number), FigureFormat.PNG)
        names = [path.stem for path in written]

        def drawn(kind, names=names):
            return sum(name.startswith(kind) for name in names)

        assert drawn("success-by-task") == 1
        assert drawn("comparison") == page.count('class="forest versus"')
        assert drawn("success-by-severity") == ('<svg class="severity' in page)
        assert drawn("losses") == page.count('<svg class="losses')
        assert drawn("confusion") == page.count("true task and inferred task, episodes")
        assert drawn("reliability") == page.count('<svg class="reliability')
        assert drawn("worker-time") == ('class="bar phases"' in page)
        if report is under_noise:
            expected = ["success-by-task", "comparison-1-merged-against-expert", "heat-map-1-expert"]
            expected += ["heat-map-2-merged", "losses-1-merged", "success-by-severity", "confusion-1-merged"]
            assert names == [*expected, "worker-time"]
        for path in written:
            with Image.open(path) as image:
                assert image.format == "PNG"
                assert COLUMN - 0.1 < image.width / 300 < COLUMN + 0.1, path  # inches


def test_figures_that_the_report_has_no_more_are_removed(clean, tmp_path):
    old = [tmp_path / name for name in ("heat-map-9-old.svg", "success-by-severity.svg", "comparison.svg")]
    kept = [tmp_path / name for name in ("heat-map-9-old.pdf", "heat-map-sketch.svg", "mine.svg", "notes.txt")]
    for file in (*old, *kept):
        file.touch()
    written = write_figures(clean, tmp_path, FigureFormat.SVG)
    assert sorted(tmp_path.iterdir()) == sorted([*written, *kept])


def test_a_figure_takes_the_place_of_a_link_and_does_not_follow_it(clean, tmp_path):
    (tmp_path / "mine").write_text("mine")
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "success-by-task.svg").symlink_to(tmp_path / "mine")
    assert tmp_path / "run" / "success-by-task.svg" in write_figures(clean, tmp_path / "run", FigureFormat.SVG)
    assert (tmp_path / "mine").read_text() == "mine"


def test_the_same_numbers_give_the_same_file(clean, tmp_path):
    files = [write_figures(clean, tmp_path, FigureFormat.SVG)[0].read_bytes() for _ in range(2)]
    assert files[0] == files[1]


def test_a_run_without_results_has_no_figures(tmp_path):
    assert write_figures(write_report(run_folder(tmp_path / "run", document(), [])), tmp_path, FigureFormat.SVG) == []


def test_without_matplotlib_one_line_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(BadInput, match=r'pip install "robogauntlet\[figures\]"'):
        check_matplotlib()
