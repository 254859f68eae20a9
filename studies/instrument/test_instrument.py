"""The page on statistics shows numbers of this study."""

from studies.instrument.instrument import counted
from studies.tables import ROOT, kept


def test_the_page_on_statistics_has_losses_and_seeds_of_the_kept_rows():
    text = (ROOT / "docs/statistics.md").read_text(encoding="utf-8")
    rows = counted(kept("instrument", "instrument")["rows"])
    shown = [f"| {row['loss']} | {row['planned']} | {row['at_planned']} |" for row in rows]
    assert sum(line in text for line in shown) == 5
