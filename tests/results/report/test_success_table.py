"""The success table as LaTeX, Markdown and CSV."""

import csv
import io
import re
import shutil
import subprocess

import pytest

from robogauntlet.results.report.formatting import share
from robogauntlet.results.report.success_table import ALL, TableFormat, render_table, success_table
from robogauntlet.suites.episode import Condition
from tests.results.synthetic import cells, document, row, rows, tables_of

PLAN = cells(("oracle", "50%_{x}<"), ("maniskill/PushCube-v1", "maniskill/A&B", "pybullet/PandaPush-v3"))
TABLES = tables_of(document(10, of=PLAN), rows(PLAN, errors=1))


def rendered(form, tables=TABLES, condition=Condition()):  # noqa: B008
    return render_table(success_table("night_1", tables, condition), form)


def test_each_simulator_and_all_of_them_have_a_row_after_the_tasks():
    table = success_table("night", TABLES, Condition())
    names = [(row.simulator, row.task) for row in table.rows]
    assert names == [
        *[("maniskill", "PushCube-v1"), ("maniskill", "A&B"), ("maniskill", ALL)],
        *[("pybullet", "PandaPush-v3"), ("pybullet", ALL), (ALL, ALL)],
    ]
    assert [tally.verdicts for tally in table.rows[-1].tallies] == [27, 27]  # errors count in no rate


def test_latex_has_the_rules_of_booktabs_and_one_cell_per_policy():
    text = rendered(TableFormat.LATEX)
    lines = text.splitlines()
    body = lines[lines.index(r"\midrule") + 1 : lines.index(r"\bottomrule")]
    assert [line for line in body if line.startswith("\\")] == [r"\midrule"] * 2  # between simulators, not at the end
    assert {len(re.findall(r"(?<!\\)&", line)) for line in body if "&" in line} == {3}
    assert r"\toprule" in lines
    assert r"\cline" not in text
    tally = TABLES.cells[0].tally
    assert share(tally).replace(" %", "") in body[0]


def test_latex_of_any_name_is_escaped():
    text = rendered(TableFormat.LATEX)
    assert r" &  & oracle & 50\%\_\{x\}\textless{} \\" in text
    assert r" & A\&B & " in text
    assert r"suite night\_1, condition clean, 54 episodes.}" in text
    assert r"\label{tab:night-1}" in text


def test_markdown_has_percent_and_intervals():
    lines = rendered(TableFormat.MARKDOWN).splitlines()
    assert lines[0].startswith("| simulator | task | oracle | ")
    assert lines[2].startswith(f"| maniskill | PushCube-v1 | {share(TABLES.cells[0].tally)} | ")
    assert len(lines) == 2 + 6


def test_csv_has_numbers():
    lines = list(csv.DictReader(io.StringIO(rendered(TableFormat.CSV))))
    tally = TABLES.cells[0].tally
    assert [float(lines[0][f"oracle {name}"]) for name in ("rate", "low", "high")] == pytest.approx(
        [tally.rate, tally.interval.low, tally.interval.high]
    )
    assert (lines[-1]["simulator"], lines[-1]["task"]) == (ALL, ALL)


def test_a_task_that_one_policy_does_not_play_has_no_rate():
    plan = [*cells(("a",), ("maniskill/One",)), *cells(("a", "b"), ("maniskill/Two",))]
    tables = tables_of(document(1, of=plan), [row(cell, 0) for cell in plan])
    assert "& One & 100 [21, 100] & -- \\\\" in rendered(TableFormat.LATEX, tables)
    assert rendered(TableFormat.CSV, tables).splitlines()[1].endswith(",,,")


def test_another_condition_has_rates_of_its_own():
    noise = Condition("noise", 4)
    plan = cells(("a",), ("maniskill/One",), (Condition(), noise))
    tables = tables_of(
        document(4, of=plan),
        [row(cell, n, "failure" if cell.condition == noise else "success") for cell in plan for n in range(4)],
    )
    assert "0 % [0, 49]" in rendered(TableFormat.MARKDOWN, tables, noise)
    assert "condition noise@4, 4 episodes" in rendered(TableFormat.LATEX, tables, noise)


SPECIAL = r"a_b%c&d#e$f~g^h\i{j}k<l>m|n" + "\"'`-- é ü ß ł ñ\x07 … – “x” µ"
"""Every character that LaTeX reads as something else, quotes and dashes, Latin letters, and a control character."""
ARTICLE = r"""\documentclass{article}
\usepackage{booktabs}
\begin{document}
%s
\end{document}
"""


def special_table():
    plan = cells((SPECIAL, "random"), (f"maniskill/{SPECIAL}", "pybullet/Reach"))
    return render_table(
        success_table(SPECIAL, tables_of(document(3, of=plan), rows(plan, 3)), Condition()), TableFormat.LATEX
    )


def test_every_special_character_is_escaped_in_every_place():
    text = special_table()
    escaped = r"a\_b\%c\&d\#e\$f\textasciitilde{}g\textasciicircum{}h\textbackslash{}i\{j\}k"
    assert text.count(escaped) == 3  # the caption, the header and a row
    assert r"\textbackslash{}x07" in text  # a control character, at which LaTeX stops
    assert re.search(r"\\label\{tab:[A-Za-z0-9-]+\}", text)


def test_letters_that_pdflatex_may_not_have_are_named():
    plan = cells(("模型",), ("maniskill/One",))
    table = success_table("night", tables_of(document(1, of=plan), rows(plan, 1)), Condition())
    assert render_table(table, TableFormat.LATEX).splitlines()[1].startswith("% has 型模: pdfLaTeX may need")
    assert "fontenc" not in rendered(TableFormat.LATEX)


@pytest.mark.nightly
@pytest.mark.skipif(
    shutil.which("pdflatex") is None, reason="no pdflatex here: apt-get install texlive-latex-recommended"
)
def test_an_article_with_the_table_compiles(tmp_path):
    (tmp_path / "article.tex").write_text(ARTICLE % special_table(), encoding="utf-8")
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "-no-shell-escape", "article.tex"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, errors="replace", timeout=120)
    assert done.returncode == 0, done.stdout[-2000:]
    assert (tmp_path / "article.pdf").stat().st_size > 1000
