"""The contents of the pages."""

import html
import re
import time
from pathlib import Path

import pytest

from robogauntlet.orchestrator.schedules.schedule import Schedule
from robogauntlet.results.api import open_run
from robogauntlet.results.live_status import STALE_S
from robogauntlet.results.report import write_report
from robogauntlet.results.report.pairwise import headline
from robogauntlet.results.run_document import RunStatus
from robogauntlet.results.store.history_records import Counts
from tests.orchestrator.dashboard.conftest import fill, serving
from tests.orchestrator.dashboard.filled import add_videos, live_status, nightly_run, running
from tests.results.synthetic import cells, document, row, run_folder


@pytest.fixture
def served(tmp_path):
    with serving(tmp_path) as found:
        yield found


def run_links(page):
    return list(dict.fromkeys(re.findall(r'href="/runs/([0-9a-z-]+)"', page)))


@pytest.mark.parametrize("path", ["/", "/runs", "/history", "/leaderboard", "/failures", "/schedule", "/compare"])
def test_a_page_of_an_empty_store_says_so_and_is_well_formed(served, path):
    page = served.get(path)
    assert page.status_code == 200
    assert page.text.count("<h1") == 1
    assert '<a class="skip" href="#main">' in page.text


def test_the_overview_shows_running_suites_with_progress_workers_and_intervals(served):
    running(served.history, live_status(120))
    page = served.get("/").text
    assert page.count('role="progressbar"') == 3
    assert 'aria-valuenow="121"' in page  # robosuite, with its error
    assert "no rate over 3 policies" in page
    assert "experts on maniskill/StackCube-v1" in page
    assert "worker robosuite-1 died" in page


def test_a_running_suite_of_one_policy_has_a_rate(served):
    plan = cells(("oracle",))
    served.history.record(document(100, of=plan, run_id="one", status=RunStatus.RUNNING), Path("/nowhere/one"))
    served.history.write_live_status("one", live_status(120))
    assert "91 % [84, 95]" in served.get("/").text


def test_the_list_of_runs_has_no_rate_of_several_policies(served):
    for run_id, policies in (("one", ("oracle",)), ("two", ("oracle", "random"))):
        plan = cells(policies)
        counted = {(cell.policy_digest, cell.task, "clean", 0): Counts(10, 9, 1) for cell in plan}
        served.history.record(document(10, of=plan, run_id=run_id), Path(f"/nowhere/{run_id}"), counted)
    page = served.get("/runs").text
    assert page.count("<b>90 %</b>") == 1
    assert "2 policies" in page


def test_a_silent_run_is_not_shown_as_running(served):
    running(served.history, live_status(at=time.time() - 7 * STALE_S))
    for path in ("/", "/runs", "/runs/running-1"):
        page = served.get(path).text
        assert "silent for 7 min" in page
        assert "pill running" not in page
    assert served.get("/api/live").json()["runs"][0]["state"] == "silent"


def test_a_complete_run_that_records_videos_says_so(served):
    run = document(4, run_id="done-1")
    served.history.record(run, Path("/nowhere/done-1"))
    served.history.write_live_status("done-1", live_status().model_copy(update={"phase": "recording videos"}))
    assert "complete, recording videos" in served.get("/runs").text
    served.history.record(run, Path("/nowhere/done-1"))
    assert "recording videos" not in served.get("/runs").text


def test_the_live_status_is_available_as_json(served):
    running(served.history, live_status(120))
    found = served.get("/api/live").json()["runs"]
    assert [(one["id"], one["state"], one["done"], one["planned"]) for one in found] == [
        ("running-1", "running", 361, 1500)
    ]
    assert found[0]["simulators"][0]["shares"] == [18.17, 1.83, 0.0]
    assert found[0]["workers"][1]["doing"] == "merged on pybullet/PandaPush-v3"


def test_the_overview_shows_last_verdicts_and_next_runs(filled):
    page = filled.get("/").text
    assert "▼ regressed" in page
    reason = next(one for one in filled.history.runs() if one.verdict == "regressed").reasons[0]
    assert reason.replace("<", "&lt;") in page


def test_runs_are_listed_the_newest_first(filled):
    assert run_links(filled.get("/runs").text) == [run.run_id for _, run, _ in reversed(filled.made)]


def test_runs_are_paged(served):
    for number in range(120):
        served.history.record(document(run_id=f"run-{number:03}", started_at=float(number)))
    first, last = served.get("/runs").text, served.get("/runs?page=3").text
    assert run_links(first) == [f"run-{number:03}" for number in range(119, 69, -1)]
    assert run_links(last) == [f"run-{number:03}" for number in range(19, -1, -1)]
    assert "101 to 120 of 120 runs" in last
    assert "The list has only 3 pages" in served.get("/runs?page=9").text


@pytest.mark.parametrize("page", ["0", "-1", "x", "1" * 40])
def test_an_invalid_page_number_is_one_line(served, page):
    answer = served.get(f"/runs?page={page}")
    assert answer.status_code == 400
    assert "page: " in answer.text


def test_runs_are_filtered_by_suite_status_and_policy(served):
    served.history.record(document(run_id="one", name="a"))
    served.history.record(document(run_id="two", name="b", status="stopped"))
    served.history.record(document(run_id="three", name="b", of=cells(policies=("merged",))))
    assert run_links(served.get("/runs?suite=a").text) == ["one"]
    assert run_links(served.get("/runs?status=stopped").text) == ["two"]
    assert run_links(served.get("/runs?policy=merged").text) == ["three"]
    assert run_links(served.get("/runs?suite=b&policy=oracle&status=").text) == ["two"]
    assert "No run matches" in served.get("/runs?suite=c").text


def test_a_run_shows_counts_with_intervals_the_verdict_and_its_baseline(filled):
    _, run, results = filled.made[-1]
    page = filled.get(f"/runs/{run.run_id}").text
    own = [one for one in results if (one.task, one.policy) == ("robosuite/Lift", "experts")]
    won = sum(one.status == "success" for one in own)
    row = re.search(r'robosuite/<wbr>Lift</th><td class="name">experts<.*?</tr>', page, re.DOTALL)[0]
    assert re.findall(r'wide">(\d+)<', row) == [str(won), str(len(own) - won), "0", "20", "20"]
    assert re.search(r"<b>\d+ %</b> <span class=\"span\">\[\d+, \d+\]", row)
    assert "▼ regressed" in page
    baseline = filled.made[-2][1].run_id
    assert f'href="/runs/{baseline}"' in page
    assert f"/compare?first={run.run_id}&amp;second={baseline}" in page
    assert "4f1c2a9 (clean)" in page


def test_an_unknown_run_is_not_found(filled):
    answer = filled.get("/runs/nothing")
    assert answer.status_code == 404
    assert "The history has no run with this id." in answer.text


def test_a_comparison_agrees_with_the_command(filled):
    _, run, _ = filled.made[-1]
    baseline = filled.made[-2][1]
    page = filled.get(f"/compare?first={run.run_id}&second={baseline.run_id}").text
    assert "<h1>REGRESSED</h1>" in page
    entry = next(one for one in filled.history.runs() if one.run_id == run.run_id)
    for reason in entry.reasons:
        assert reason.replace("<", "&lt;") in page
    assert 'class="worse"' in page


def test_two_policies_are_compared_as_in_the_report(filled):
    _, run, _ = filled.made[-1]
    page = filled.get(f"/compare?first={run.run_id}:experts&second={run.run_id}:merged").text
    found = open_run(filled.made[-1][0]).compare("experts", "merged")
    assert "<h1>experts against merged</h1>" in page
    assert headline(found.comparisons[0]).replace("<", "&lt;") in page
    assert page.count('class="forest versus"') == 1
    assert f'<option value="{run.run_id}:merged" selected>' in page
    assert " style=" not in page


def test_a_policy_is_compared_with_that_of_another_run(filled):
    runs = [run.run_id for _, run, _ in filled.made]
    page = filled.get(f"/compare?first={runs[-1]}:experts&second={runs[0]}:experts").text
    assert "<h1>nightly-003:experts against nightly-000:experts</h1>" in page


def test_all_policies_of_a_run_are_compared(filled):
    _, run, _ = filled.made[-1]
    page = filled.get(f"/compare?first={run.run_id}").text
    assert page.count("<summary>") == 3
    assert "Policies with letters" in page
    assert f'href="/compare?first={run.run_id}"' in filled.get(f"/runs/{run.run_id}").text


def test_policies_that_cannot_be_compared_are_one_line(filled):
    run_id = filled.made[-1][1].run_id
    page = filled.get(f"/compare?first={run_id}:experts&second={run_id}:expert").text
    assert "the run has no policy &#39;expert&#39;; did you mean &#39;experts&#39;?" in page
    assert filled.get("/compare?first=nothing:a&second=nothing:b").status_code == 404


def test_comparing_is_in_the_navigation(served):
    assert '<a href="/compare" aria-current="page">Compare</a>' in served.get("/compare").text


def test_a_comparison_without_rows_is_one_line(served):
    far = {"store_url": "postgresql+psycopg://user:***@far/db"}
    served.history.record(document(run_id="one", **far))
    served.history.record(document(run_id="two", **far))
    page = served.get("/compare?first=one&second=two").text
    assert "its rows are in postgresql+psycopg://user:***@far/db" in page


def test_the_history_has_a_row_per_run_with_its_interval(filled):
    page = filled.get("/history?policy=merged&suite=nightly&task=robosuite/Lift").text
    assert page.count('<th scope="row"') == page.count('<svg class="interval') == 4
    assert "No run matches" in filled.get("/history?policy=unknown").text


def test_the_leaderboard_has_each_policys_newest_run_and_letters(filled):
    page = filled.get("/leaderboard?suite=nightly").text
    assert page.count('<th scope="row"') == 3
    assert f'href="/runs/{filled.made[-1][1].run_id}"' in page
    assert re.search(r"<td><b>a</b></td>", page)


def test_the_leaderboard_names_a_run_without_rows_and_uses_an_older_one(tmp_path):
    made = fill(tmp_path, nights=2)
    (made[1][0] / "episodes.sqlite").write_bytes(b"garbage that is no store at all")
    with serving(tmp_path) as served:
        page = served.get("/leaderboard?suite=nightly").text
    assert "nightly-001 is left out" in page
    assert f'href="/runs/{made[0][1].run_id}"' in page


def test_the_schedule_shows_next_times_outcomes_and_runs(served):
    nightly = Schedule(name="nightly", suite="mergevla", cron="0 2 * * *", timezone="Europe/Berlin")
    served.schedule_store.write(nightly, next_due_at=time.time() + 7300.0, seen_at=time.time(), outcome="disk full")
    served.history.record(document(run_id="one", name="a"), Path("/nowhere/night-1"), schedule="nightly")
    served.history.record(document(run_id="two", name="b"), Path("/nowhere/by-hand"))
    page = served.get("/schedule").text
    for words in ("<code>0 2 * * *</code>", "Europe/Berlin", "disk full", "in 2 h", "night-1"):
        assert words in page
    assert "by-hand" not in page
    assert ">nightly</a>" in served.get("/").text


def test_schedules_whose_server_has_gone_are_said_to_be_unserved(served):
    nightly = Schedule(name="nightly", suite="mergevla", cron="0 2 * * *")
    served.schedule_store.write(nightly, next_due_at=time.time() + 7300.0, seen_at=time.time())
    assert "robogauntlet_schedules_served 1.0" in served.get("/metrics").text
    assert "not served" not in served.get("/").text
    served.schedule_store.write(nightly, seen_at=time.time() - 3600.0)
    assert "robogauntlet_schedules_served 0.0" in served.get("/metrics").text
    for path in ("/", "/schedule"):
        assert "not served since" in served.get(path).text


def test_videos_of_failures_are_shown_and_filtered(filled):
    page = filled.get("/failures").text
    videos = re.findall(r'<video[^>]* src="([^"]+)"', page)
    assert len(videos) == 3
    assert page.count('preload="none"') == 3
    assert page.count(" poster=") == 3
    assert filled.get(videos[0]).headers["content-type"] == "video/mp4"
    failed = next(one for one in filled.made[-1][2] if one.status == "failure")
    assert "<video" in filled.get(f"/failures?task={failed.task}&policy={failed.policy}").text
    assert "<video" not in filled.get("/failures?policy=unknown").text
    assert "<video" not in filled.get(f"/failures?run={filled.made[0][1].run_id}").text


def test_a_video_that_policies_share_is_shown_for_each(served, tmp_path):
    plan = cells(("experts", "merged"), ("robosuite/Lift",))
    failed = [row(cell, 0, "failure", actions_hash="same") for cell in plan]
    run = document(1, plan, run_id="shared")
    folder = run_folder(tmp_path / "shared", run, failed)
    add_videos(folder, run, failed[:1])
    served.history.record(run, folder)
    page = served.get("/failures?run=shared").text
    assert len(set(re.findall(r'<video[^>]* src="([^"]+)"', page))) == 1
    assert re.findall(r'aria-label="Failure of (\w+) on', page) == ["experts", "merged"]


def test_videos_of_failures_name_their_kind_and_are_filtered_by_it(served, tmp_path):
    (cell,) = cells(("experts",), ("robosuite/Lift",))
    kinds = ("dropped", "misplaced", "<b>melted")
    failed = [row(cell, seed, "failure", failure=kind) for seed, kind in enumerate(kinds)]
    run = document(3, [cell], run_id="kinds")
    folder = run_folder(tmp_path / "kinds", run, failed)
    add_videos(folder, run, failed)
    served.history.record(run, folder)
    page = served.get("/failures?run=kinds").text
    assert re.findall(r'aria-label="([^"]+) of experts on', page) == [
        "Failure: dropped",
        "Failure: misplaced",
        "Failure",
    ]
    assert "<br>failure: dropped<br>" in page
    assert '<option value="dropped">' in page
    shown = served.get("/failures?run=kinds&kind=misplaced").text
    assert re.findall(r'aria-label="([^"]+) of experts on', shown) == ["Failure: misplaced"]


def test_a_part_of_a_video_can_be_requested(filled):
    video = re.search(r'<video[^>]* src="([^"]+)"', filled.get("/failures").text)[1]
    part = filled.get(video, headers={"range": "bytes=10-19"})
    assert part.status_code == 206
    assert len(part.content) == 10


def test_a_report_is_shown_in_a_sandbox_in_which_only_its_own_script_runs(tmp_path):
    folder, run, _ = nightly_run(tmp_path, 0, 0.0, seeds=2)
    write_report(folder)
    with serving(tmp_path) as served:
        while not served.get(f"/runs/{run.run_id}").is_success:
            time.sleep(0.05)  # it is being taken in
        answer = served.get(f"/runs/{run.run_id}/files/report.html")
        page = served.get(f"/runs/{run.run_id}").text
    assert answer.status_code == 200
    policy = answer.headers["content-security-policy"]
    assert policy.startswith("sandbox allow-scripts; default-src 'none'")
    assert re.findall("script-src ([^;]*)", policy) == [re.search('script-src ([^"]*)', html.unescape(answer.text))[1]]
    assert f"/runs/{run.run_id}/files/report.html" in page


def test_metrics_have_running_suites_verdicts_and_next_runs(served):
    running(served.history, live_status(120), suite='we"ird\nname')
    served.history.record(document(run_id="old", name="nightly", started_at=1.0))
    served.history.write_verdict("old", "improved", None, [])
    served.history.record(document(run_id="new", name="nightly", started_at=2.0))
    served.history.write_verdict("new", "regressed", None, [])
    night = Schedule(name="night", suite="mergevla", cron="0 2 * * *")
    served.schedule_store.write(night, next_due_at=1234.0, seen_at=time.time())
    text = served.get("/metrics").text
    assert 'robogauntlet_runs{status="running"} 1.0' in text
    assert 'robogauntlet_runs{status="complete"} 2.0' in text
    label = r'run="running-1",simulator="pybullet",suite="we\"ird\nname"'
    assert f"robogauntlet_running_done{{{label}}} 120.0" in text
    assert f'robogauntlet_running_episodes{{outcome="success",{label}}} 116.0' in text
    assert 'robogauntlet_last_verdict{suite="nightly",verdict="regressed"} 1.0' in text
    assert 'robogauntlet_last_verdict{suite="nightly",verdict="improved"} 0.0' in text
    assert 'robogauntlet_schedule_next_due_seconds{schedule="night"} 1234.0' in text


def test_run_folders_are_imported_automatically(tmp_path):
    _, run, _ = nightly_run(tmp_path, 0, 0.0, seeds=2)
    with serving(tmp_path) as served:
        while run.run_id not in served.get("/runs").text:
            time.sleep(0.05)
