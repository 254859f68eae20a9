"""The drawings of docs/concepts.md and docs/architecture.md."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from scripts.site.drawing import Drawing


def flow() -> Drawing:
    """The stages from a suite to its report."""
    sheet = Drawing(520, 452)
    title, sub = "bold", "soft small"
    sheet.box(20, 14, 200, 58, [("suite", title), ("policies, tasks, conditions, seeds", sub)])
    sheet.box(310, 14, 190, 58, [("episodes", title), ("ids fixed, nothing played yet", sub)])
    sheet.arrow([(220, 43), (308, 43)])
    sheet.text(263, 36, "validated", sub, anchor="middle")
    sheet.arrow([(405, 72), (405, 104), (260, 104), (260, 126)])
    sheet.box(140, 128, 240, 46, [("scheduler", title), ("leases, retries, continuation", sub)], "pale-one")
    for x, name in ((20, "ManiSkill"), (192, "PyBullet"), (364, "robosuite")):
        sheet.arrow([(260, 174), (260, 190), (x + 68, 190), (x + 68, 212)])
        sheet.box(
            x, 214, 136, 82, [("worker", title), (name, "one small bold"), ("observe, act, step", sub)], "pale-one"
        )
        sheet.arrow([(x + 68, 296), (x + 68, 320), (260, 320), (260, 340)])
    sheet.box(160, 342, 200, 42, [("rows", title), ("one per episode, keyed by its id", sub)], "pale-three")
    sheet.arrow([(160, 363), (110, 363), (110, 400)])
    sheet.arrow([(360, 363), (410, 363), (410, 400)])
    sheet.arrow([(260, 384), (260, 400)])
    sheet.box(30, 402, 160, 40, [("report", title)], "pale-three")
    sheet.box(200, 402, 120, 40, [("gate", title)], "pale-three")
    sheet.box(330, 402, 160, 40, [("history, dashboard", title)], "pale-three")
    return sheet


def packages() -> Drawing:
    """The five packages; an arrow means that one imports the other."""
    sheet = Drawing(520, 236)
    sheet.box(
        150, 10, 220, 48, [("orchestrator", "bold"), ("scheduler, workers, command line", "soft small")], "pale-one"
    )
    sheet.box(16, 98, 150, 48, [("policies", "bold"), ("baselines, oracles, ...", "soft small")])
    sheet.box(185, 98, 150, 48, [("adapters", "bold"), ("simulators", "soft small")])
    sheet.box(354, 98, 150, 48, [("results", "bold"), ("statistics, report", "soft small")], "pale-three")
    sheet.box(150, 182, 220, 46, [("suites", "bold"), ("suite files, episode ids", "soft small")])
    sheet.arrow([(190, 58), (110, 96)])
    sheet.arrow([(260, 58), (260, 96)])
    sheet.arrow([(330, 58), (410, 96)])
    sheet.arrow([(166, 122), (183, 122)])
    sheet.arrow([(110, 146), (190, 180)])
    sheet.arrow([(260, 146), (260, 180)])
    sheet.arrow([(410, 146), (330, 180)])
    return sheet


def pairs() -> Drawing:
    """Two episodes of one pair."""
    sheet = Drawing(520, 250)
    sheet.box(4, 92, 142, 66, [("pair", "bold"), ("task, condition, seed,", "soft small"), ("protocol", "soft small")])
    for y, name, kind, end, mark in (
        (14, "policy A", "pale-one", "success", "three"),
        (158, "policy B", "pale-two", "failure", "two"),
    ):
        sheet.box(
            204,
            y,
            130,
            78,
            [(name, "bold"), ("episode: pair and", "soft small"), ("policy by content", "soft small")],
            kind,
        )
        sheet.arrow([(146, 125), (172, 125), (172, y + 39), (202, y + 39)])
        sheet.arrow([(334, y + 39), (396, y + 39)])
        sheet.box(398, y + 17, 108, 44, [(end, f"bold {mark}")])
    sheet.rect(188, 106, 318, 38, "shade", round_=6)
    sheet.text(347, 122, "the same first state (equal state_hash),", "small", anchor="middle")
    sheet.text(347, 137, "the same perturbation: only the policy differs", "small", anchor="middle")
    return sheet


def policies() -> Drawing:
    """Experts, oracle-routed and self-routed policies: what each difference isolates."""
    sheet = Drawing(520, 300)
    sheet.text(20, 22, "policy", "soft small")
    sheet.text(330, 22, "what the difference measures", "soft small")
    rows = (
        (34, "experts", "one network per task, given the task", "pale-one"),
        (126, "merged, oracle-routed", "one network for all tasks, given the task", "pale-three"),
        (218, "merged, self-routed", "the same network, infers the task", "pale-two"),
    )
    for y, name, what, kind in rows:
        sheet.box(20, y, 280, 62, [(name, "bold"), (what, "soft small")], kind)
    for y, name, what in (
        (80, "loss by merging", "the cost of one shared network"),
        (172, "loss by routing", "the cost of inferring the task"),
    ):
        sheet.line([(300, y), (314, y), (314, y + 62), (300, y + 62)], "rule")
        sheet.text(330, y + 28, name, "bold")
        sheet.text(330, y + 46, what, "soft small")
    return sheet


def inference() -> Drawing:
    """How a merged policy infers its task."""
    sheet = Drawing(520, 262)
    sheet.box(
        14,
        20,
        146,
        76,
        [
            ("first observation", "bold"),
            ("images, proprioception,", "soft small"),
            ("instruction (or hidden)", "soft small"),
        ],
    )
    sheet.box(
        200,
        20,
        120,
        76,
        [("router", "bold"), ("one pass of the", "soft small"), ("backbone", "soft small")],
        "pale-one",
    )
    sheet.arrow([(160, 58), (198, 58)])
    scores = (
        ("push", 12, "fill-soft"),
        ("pick and place", 40, "fill-two"),
        ("reach", 20, "fill-soft"),
        ("unknown?", 7, "fill-soft"),
    )
    for number, (name, width, kind) in enumerate(scores):
        y = 22 + 20 * number
        sheet.rect(362, y, width, 13, kind, round_=2)
        sheet.text(368 + width, y + 11, name, "small" if kind == "fill-soft" else "small bold two")
    sheet.arrow([(320, 58), (354, 58)])
    sheet.arrow([(410, 104), (410, 146)])
    sheet.text(402, 130, "the choice, once per episode", "soft small", anchor="end")
    sheet.box(
        300,
        148,
        206,
        62,
        [("this task's mask and head", "bold"), ("applied to the merged weights", "soft small")],
        "pale-two",
    )
    sheet.box(
        40, 148, 206, 62, [("action chunks", "bold"), ("for the rest of the episode", "soft small")], "pale-three"
    )
    sheet.arrow([(300, 179), (248, 179)])
    sheet.text(
        260,
        244,
        "Scores, choice and latency are stored in the row; the report has the confusion matrix.",
        "soft small",
        anchor="middle",
    )
    return sheet


CONCEPTS: Mapping[str, Callable[[], Drawing]] = {
    "flow": flow,
    "packages": packages,
    "pairs": pairs,
    "policies": policies,
    "inference": inference,
}
