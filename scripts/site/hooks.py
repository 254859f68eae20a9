"""What MkDocs cannot do by itself: pages made from the program, and drawings that lie in the page."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[2]
DECISIONS = "decisions"
OUTWARD = re.compile(r"(?<!!)\[(?P<text>[^\]]*)\]\((?P<target>\.\./[^)\s]*)\)")
"""A link that may lead out of the documentation."""
DRAWING = re.compile(
    r'<img\s[^>]*?alt="(?P<alt>[^"]*)"[^>]*?src="(?P<src>[^"]*images/(?:concepts|statistics)/[^"]+\.svg)"[^>]*>'
)


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Put the decisions, which are numbered files, into the navigation."""
    folder = ROOT / "docs" / DECISIONS
    pages = [{_title(path): f"{DECISIONS}/{path.name}"} for path in sorted(folder.glob("[0-9]*.md"))]
    config.nav = [_replaced(entry, pages) for entry in config.nav or []]
    return config


def _replaced(entry: Any, pages: list[dict[str, str]]) -> Any:
    if not isinstance(entry, dict):
        return entry
    ((name, value),) = entry.items()
    if value == f"{DECISIONS}/":
        return {name: pages}
    return {name: [_replaced(one, pages) for one in value] if isinstance(value, list) else value}


def _title(path: Path) -> str:
    return path.read_text(encoding="utf-8").splitlines()[0].removeprefix("# ")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are made anew at each build."""
    for name, text in (
        ("changelog.md", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")),
        ("contributing.md", (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")),
        ("reference/cli.md", command_line()),
    ):
        files.append(File.generated(config, name, content=text))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Leave out links to the program's own files, which are not in the site; those to nothing stay, and are told."""
    folder = (Path(config.docs_dir) / page.file.src_path).parent

    def replaced(found: re.Match[str]) -> str:
        target = (folder / found["target"].partition("#")[0]).resolve()
        ours = target.is_relative_to(ROOT) and not target.is_relative_to(config.docs_dir)
        return found["text"] if ours and target.exists() else found[0]

    return OUTWARD.sub(replaced, markdown)


def on_page_content(html: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Lay our own drawings into the page, where they take its colours and fonts."""
    return DRAWING.sub(lambda found: _drawing(found["src"], found["alt"], page), html)


def _drawing(source: str, alt: str, page: Page) -> str:
    path = ROOT / "docs" / "images" / source.rpartition("images/")[2]
    try:
        svg = path.read_text(encoding="utf-8")
    except OSError as error:
        raise PluginError(f"{page.file.src_path}: expected a drawing {path.name}: {error.strerror}") from None
    body = re.sub(r"<style>.*?</style>", "", svg, flags=re.DOTALL)  # the site's style sheet has the same rules
    return f'<span class="drawing">{body.replace("<svg ", f"""<svg role="img" aria-label="{alt}" """, 1)}</span>'


def command_line() -> str:
    """The reference of the command line, from the Typer application itself."""
    from typer.main import get_command

    from orchestrator.cli import app

    root: Any = get_command(app)
    lines = [
        "# Command line",
        "",
        "`gauntlet VERB --help` says the same. Made from the program when this site is built.",
        "",
        "| exit code | meaning |",
        "|---|---|",
        "| 0 | done |",
        "| 1 | something differs, is worse, or does not work |",
        "| 2 | bad input: a line for each mistake, nothing was started |",
        "| 3 | stopped early; the same command continues |",
        "| 130 | interrupted; the same command continues |",
        "",
    ]
    for name, command in root.commands.items():
        lines += _command(f"gauntlet {name}", command, 2)
    return "\n".join(lines) + "\n"


def _command(name: str, command: Any, level: int) -> Iterator[str]:
    context = command.make_context(name, [], resilient_parsing=True)
    yield from (f"{'#' * level} {name}", "")
    if command.help:
        yield from (command.help.replace("\n\f", ""), "")
    if hasattr(command, "commands"):
        for sub, own in command.commands.items():
            yield from _command(f"{name} {sub}", own, level + 1)
        return
    usage = " ".join(part for one in command.get_params(context) for part in one.get_usage_pieces(context))
    yield from (
        "```",
        f"{name} {'[OPTIONS] ' if any(map(_is_option, command.params)) else ''}{usage}".rstrip(),
        "```",
        "",
    )
    records = [one.get_help_record(context) for one in command.params if not one.hidden]
    if records := [record for record in records if record]:
        yield from ("| argument, option | meaning |", "|---|---|")
        yield from (f"| {_code(what)} | {_cell(help_)} |" for what, help_ in records)
        yield ""


def _is_option(parameter: Any) -> bool:
    return str(parameter.param_type_name) == "option"


def _code(text: str) -> str:
    return f"<code>{_cell(text).replace('&#124;', '&#124;<wbr>')}</code>"


def _cell(text: str) -> str:
    for plain, escaped in (
        ("&", "&amp;"),
        ("<", "&lt;"),
        ("|", "&#124;"),
        ("*", "&#42;"),
        ("_", "&#95;"),
        ("[", "&#91;"),
    ):
        text = text.replace(plain, escaped)
    return text
