"""Pictures of the tasks, and recorded episodes."""

from __future__ import annotations

from collections.abc import Iterator

from robogauntlet.results.record import Status
from robogauntlet.results.report.blocks import Block, Card, Cards, Command, Fold, Paragraph
from robogauntlet.results.report.formatting import count, counted
from robogauntlet.results.report.media import Video, task_picture
from robogauntlet.results.report.section import Page, Section
from robogauntlet.results.report.sections.rates import task_groups

LONG = 18
"""Images and videos beyond which they are folded."""


def _blocks(_: None, page: Page) -> Iterator[Block]:
    document, media, cards = page.report.document, page.media, _cards(page)
    if not cards and not document.media_left_out:
        return
    blocks: list[Block] = [
        Paragraph(
            "The third-person image of each task, and per policy the recorded success and failure with the lowest "
            "seeds. A video shows its last frame until it is played. Policies that acted identically share one.",
            is_of_plot=True,
        )
    ]
    if document.media_left_out:
        left_out = f"Not recorded: {count(document.media_left_out)}"
        record = f"{document.command} --media"
        blocks.append(Command(f"{left_out}; to record all", record) if document.command else Paragraph(f"{left_out}."))
    if media.left_out:
        kept = "to keep this file small: see media/videos in the run folder."
        blocks.append(Paragraph(f"{counted(media.left_out, 'video')} left out {kept}", is_of_plot=True))
    shown = f"{counted(len(cards), 'task')}, {counted(len(media.representative), 'video')}"
    is_open = len(cards) + len(media.representative) <= LONG
    yield Fold(shown, (*blocks, Cards(tuple(cards))), is_open, title="")


def _cards(page: Page) -> list[Card]:
    document, tables = page.report.document, page.report.tables
    recorded: dict[tuple[str, str], list[Video]] = {}
    for video in sorted(page.media.representative, key=lambda video: video.status != Status.SUCCESS):
        recorded.setdefault((video.policy_digest, video.task), []).append(video)
    several = len(tables.conditions) > 1
    cards = []
    for simulator in tables.simulators:
        for task, cells in task_groups(tables, simulator, page.report.shown).items():
            picture = task_picture(page.folder, task)
            videos = [recorded.get((cell.policy_digest, cell.task), []) for cell in cells]
            captioned = [tuple((one, _caption(one, several)) for one in found) for found in videos]
            lines = [(c.policy, c.tally, shown) for c, shown in zip(cells, captioned, strict=True)]
            if picture or any(captioned):
                cards.append(Card(task, document.instructions.get(task), picture, tuple(lines)))
    return cards


def _caption(video: Video, several: bool) -> str:
    return f"{video.outcome}, seed {video.seed}" + (f", {video.condition}" if several else "")


SECTIONS = (Section("gallery", "Gallery", _blocks),)
