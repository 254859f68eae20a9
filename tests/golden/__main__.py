"""`python -m tests.golden [KIND ...]`: compare the record of the kept runs with what today's tree makes of them.

Exit code 1 if they differ. `--write` makes the record anew. `--play` plays the suite first and keeps its rows; it needs
the simulators and policies of the suite; `--draw` draws rows instead; `--identify` keeps all outcomes under the
identities that are planned today.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

from tests.golden.commands import elsewhere, said
from tests.golden.drawn import draw
from tests.golden.identities import identify
from tests.golden.kept import BASELINE, KINDS, PLAYED, KeptRun
from tests.golden.record import differences, write


def play(kind: str) -> None:
    """Play the suite of a kind, and that of its baseline, and keep both runs."""
    from robogauntlet.results.run_document import read_run, store_url
    from robogauntlet.results.store.episode_store import Store

    for kept in (KeptRun(kind, PLAYED), KeptRun(kind, BASELINE)):
        if not kept.suite.exists():
            continue
        with tempfile.TemporaryDirectory(prefix="golden-") as name, elsewhere(Path(name)):
            code, _, problems = said(f"run {kept.suite} --out run --no-media")
            if code not in (0, 3):
                sys.exit(problems)
            document = read_run(Path("run"))
            with closing(Store.open(store_url(Path("run"), document), document.run_id)) as store:
                kept.keep(document, [*store.results()])


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.golden", description=__doc__)
    parser.add_argument("kinds", nargs="*", metavar="KIND", help=f"only these of {', '.join(KINDS)}")
    parser.add_argument("--write", action="store_true", help="make the record anew from the kept rows")
    parser.add_argument("--play", action="store_true", help="play the suites first, and keep their rows")
    parser.add_argument("--draw", action="store_true", help="draw their rows instead, where playing them takes long")
    parser.add_argument("--identify", action="store_true", help="keep the rows under today's identities")
    options = parser.parse_args(arguments)
    if unknown := [kind for kind in options.kinds if kind not in KINDS]:
        parser.error(f"no kind '{unknown[0]}'; there are {', '.join(KINDS)}")
    making = options.write or options.play or options.draw or options.identify
    found = list[str]()
    for kind in options.kinds or KINDS:
        if options.play:
            play(kind)
        if options.draw:
            draw(kind)
        if options.identify:
            identify(kind)
        if making:
            write(kind)
        else:
            lines, unplanned = differences(kind)
            found += lines
            if unplanned:
                print(f"{kind}: its plan is not compared: {unplanned}", file=sys.stderr)
    print("written" if making else "\n".join(found) or "the record is as it was")
    return bool(found)


if __name__ == "__main__":
    sys.exit(main())
