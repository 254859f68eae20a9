"""Contact sheets of the images at every severity."""

import numpy as np
import pytest
from PIL import Image

from robogauntlet.orchestrator.cli.list.axes import SHEET
from robogauntlet.orchestrator.replay.contact_sheet import (
    HEADING_HEIGHT,
    LABEL_WIDTH,
    TITLE_HEIGHT,
    as_png,
    draw_contact_sheet,
    render_severities,
)
from robogauntlet.suites.axes import AXES
from robogauntlet.suites.episode import RenderProfile, View

TOP = TITLE_HEIGHT + HEADING_HEIGHT
VIEW = View(image_size=48, render_profile=RenderProfile.FAST)


def shades(*values):
    return [[np.full((48, 48, 3), value, np.uint8)] * 2 for value in values]


def test_a_sheet_has_a_column_for_each_severity_and_a_line_for_each_task():
    tasks = [("a/One", shades(0, 1, 2, 3, 4, 5)), ("b/Two", shades(10, 11, 12, 13, 14, 15))]
    page = np.asarray(draw_contact_sheet(AXES["blur"], tasks))
    columns = [LABEL_WIDTH + severity * 52 + 20 for severity in range(6)]
    assert [page[TOP + 24, column, 0] for column in columns] == [0, 1, 2, 3, 4, 5]
    assert [page[TOP + 104 + 60, column, 0] for column in columns] == [10, 11, 12, 13, 14, 15]


def test_a_sheet_may_be_replaced_by_the_next_one(tmp_path):
    page = draw_contact_sheet(AXES["blur"], [("a/One", shades(0, 1, 2, 3, 4, 5))])
    SHEET.write(tmp_path / "sheet.png", as_png(page))
    SHEET.write(tmp_path / "sheet.png", as_png(page))


def test_headings_stay_within_their_columns():
    blank = np.asarray(draw_contact_sheet(AXES["illuminance"], [("a/One", shades(0, 0, 0, 0, 0, 0))]))
    headings = blank[TOP - 20 : TOP].min(axis=(0, 2))
    between = [LABEL_WIDTH + severity * 52 + 48 + offset for severity in range(6) for offset in range(4)]
    assert set(headings[between]) == {255}
    assert all(headings[LABEL_WIDTH + severity * 52 :][:48].min() < 128 for severity in range(6))


@pytest.mark.simulator
def test_images_differ_more_with_each_severity():
    clean, *others = (
        np.stack(images).astype(float) for images in render_severities("pybullet/PandaPush-v3", AXES["noise"], VIEW, 0)
    )
    errors = [np.abs(other - clean).mean() for other in others]
    assert errors == sorted(errors)
    assert errors[0] > 0


@pytest.mark.simulator
def test_a_sheet_is_written_by_one_command(run_command, tmp_path):
    options = ["--pictures", "orbit.png", "--task", "pybullet/PandaReach-v3", "--image-size", "48"]
    assert run_command("list", "axes", "camera-orbit", *options).code == 0
    assert Image.open(tmp_path / "orbit.png").size == (LABEL_WIDTH + 6 * 52, TOP + 104)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["orbit", "--pictures", "a.png"], "unknown axis 'orbit'; did you mean 'camera-orbit'?"),
        (["camera-orbit", "--pictures", "a.jpg"], "expected a file that ends in .png for --pictures"),
        (["camera-orbit", "--pictures", "a.png", "--task", "null/Reach"], "does not let its cameras be adjusted"),
        (["blur", "--pictures", "a.png", "--task", "pybullet/PandaRech-v3"], "did you mean 'pybullet/PandaReach-v3'?"),
        (
            ["dynamics", "--pictures", "a.png", "--task", "pybullet/PandaReach-v3"],
            "axis 'dynamics' is unsupported in pybullet/PandaReach-v3: the arm can move nothing in it",
        ),
        (["blur", "--pictures", "a.png", "--task", "null/Reach"], "null/Reach: blur@1: expected blurred images"),
    ],
)
def test_a_mistake_is_one_line_and_leaves_no_file(run_command, arguments, message, tmp_path):
    assert message in run_command("list", "axes", *arguments).refusal
    assert not list(tmp_path.iterdir())
