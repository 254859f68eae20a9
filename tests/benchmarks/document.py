"""Copies measurements into the documentation: `python -m tests.benchmarks.document frames control_step`.

Pages show the table of `docs/measurements/NAME.json` between `<!-- measured: NAME -->` and `<!-- end -->`.
"""

import json
import re
import shutil
import sys
from collections.abc import Iterator

from tests import ROOT
from tests.benchmarks.shared import FOLDER

PAGES = sorted((ROOT / "docs").glob("*.md"))
MEASUREMENTS = ROOT / "docs/measurements"
END = "<!-- end -->"
BLOCK = re.compile(rf"(<!-- measured: (\w+) -->\n).*?{END}", re.DOTALL)


def markdown(name: str) -> Iterator[str]:
    """Lines of a measurement's table, and of how it was made."""
    measured = json.loads((MEASUREMENTS / f"{name}.json").read_text(encoding="utf-8"))
    columns: dict[str, str] = measured["columns"]
    cells = [[text.format(**row) for text in columns.values()] for row in measured["rows"]]
    yield from (f"| {' | '.join(line)} |" for line in (columns, ["---"] * len(columns), *cells))
    versions = ", ".join(f"{package} {version}" for package, version in measured["versions"].items())
    yield from ("", f"`python -m tests.benchmarks {name}`, {measured['date']}; {measured['machine']}; {versions}.")


def with_measurements(text: str) -> str:
    """The page with all its blocks as the committed measurements have them."""
    return BLOCK.sub(lambda found: "\n".join((found[1], *markdown(found[2]), "", END)), text)


if __name__ == "__main__":
    MEASUREMENTS.mkdir(exist_ok=True)
    for benchmark in sys.argv[1:]:
        for file in (ROOT / FOLDER).glob(f"{benchmark}.*"):  # rows, and what they are made from or shown in
            shutil.copy(file, MEASUREMENTS)
    for page in PAGES:
        page.write_text(with_measurements(page.read_text(encoding="utf-8")), encoding="utf-8")
