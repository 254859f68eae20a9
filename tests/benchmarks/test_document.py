"""Tables of measurements in the documentation are those of the committed rows."""

from tests.benchmarks.document import BLOCK, MEASUREMENTS, PAGE, with_measurements


def test_the_page_shows_the_committed_measurements():
    text = PAGE.read_text(encoding="utf-8")
    assert with_measurements(text) == text


def test_every_committed_measurement_is_shown():
    shown = {name for _, name in BLOCK.findall(PAGE.read_text(encoding="utf-8"))}
    assert shown == {path.stem for path in MEASUREMENTS.glob("*.json")}
