"""Tables of measurements in the documentation are those of the committed rows."""

import json
import re
from string import ascii_lowercase

import numpy as np
import pandas as pd
import pytest

from tests import ROOT
from tests.benchmarks import (
    gpu_runs,
    libero_experts,
    libero_merges,
    libero_oracles,
    libero_plus,
    libero_routers,
    more_experts,
    more_experts_routing,
    oracles,
    shifted_routing,
    training_controls,
)
from tests.benchmarks.document import BLOCK, MEASUREMENTS, PAGES, with_measurements
from tests.benchmarks.operators import rows_of
from tests.benchmarks.routers import SEEDS, interval
from tests.chaos.__main__ import table


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_pages_show_the_committed_measurements(page):
    text = page.read_text(encoding="utf-8")
    assert with_measurements(text) == text


def test_every_committed_measurement_is_shown():
    shown = {name for page in PAGES for _, name in BLOCK.findall(page.read_text(encoding="utf-8"))}
    assert shown == {path.stem for path in MEASUREMENTS.glob("*.json")}


@pytest.mark.parametrize("name", ["chaos", "chaos_cluster"])
def test_tables_of_runs_under_faults_count_the_committed_runs(name):
    measured = json.loads((MEASUREMENTS / f"{name}.json").read_text(encoding="utf-8"))
    assert table(measured["campaigns"]) == measured["rows"]


@pytest.mark.parametrize("name", ["operators", "ablations"])
def test_tables_of_merges_count_the_committed_episodes(name):
    measured = json.loads((MEASUREMENTS / f"{name}.json").read_text(encoding="utf-8"))
    sizes = {row["policy"]: row["kilobytes"] for row in measured["rows"]}
    assert rows_of(pd.read_parquet(MEASUREMENTS / f"{name}.parquet"), sizes) == measured["rows"]


def test_the_table_of_more_experts_counts_the_committed_episodes():
    rows = json.loads((MEASUREMENTS / "more_experts.json").read_text(encoding="utf-8"))["rows"]
    assert more_experts.rows_of(pd.read_parquet(MEASUREMENTS / "more_experts.parquet"), rows) == rows


def test_rates_of_routers_of_more_experts_are_those_of_the_committed_decisions():
    for row in json.loads((MEASUREMENTS / "more_experts_routing.json").read_text(encoding="utf-8"))["rows"]:
        for instruction in ("read", "hidden"):
            right = more_experts_routing.right(row[f"decisions, {instruction}"])
            assert len(right) == row["experts"] * more_experts_routing.SEEDS
            assert row[instruction] == interval(right)


def test_what_the_page_says_of_more_experts_beside_the_tables_is_counted_in_their_rows():
    rows = pd.read_parquet(MEASUREMENTS / "more_experts.parquet")
    own = rows[(rows.policy == more_experts.EXPERTS) & (rows.status == "success")].groupby("task").size()
    named = {"coffee-push": 8, "reach-wall": 7, "push": 6, "reach": 6, "pick-place": 4}
    assert {task: own[f"metaworld/{task}-v3"] for task in named} == named
    assert (own >= 9).sum() == len(own) - len(named) == 15
    routed = json.loads((MEASUREMENTS / "more_experts_routing.json").read_text(encoding="utf-8"))["rows"]
    blind = {row["router"]: row for row in routed if row["experts"] == 20}
    names = [task.removeprefix("metaworld/").removesuffix("-v3") for task in blind["calibrated"]["tasks"]]
    chosen = [names[ascii_lowercase.index(letter)] for letter in blind["calibrated"]["decisions, hidden"]]
    wrong = [{name, names[place // 50]} for place, name in enumerate(chosen) if name != names[place // 50]]
    pairs = ({"faucet-open", "faucet-close"}, {"reach", "pick-place"})
    assert (len(wrong), *(wrong.count(pair) for pair in pairs)) == (127, 44, 43)
    for row in (row for row in routed if row["router"] == "paper-coded" and row["experts"] >= 6):
        assert set(row["decisions, hidden"]) == {ascii_lowercase[names.index("button-press")]}
    labelled = blind["self-trained"]["decisions, read"]
    given = [set(labelled[50 * place : 50 * place + 50]) for place in range(20)]
    assert sum(len(one) == 1 and one != {ascii_lowercase[place]} for place, one in enumerate(given)) == 15


def test_what_the_page_says_of_other_bases_is_in_the_rows():
    rows = json.loads((MEASUREMENTS / "training_controls.json").read_text(encoding="utf-8"))["rows"]
    mean = {row["kind"]: row["mean"] for row in rows}
    merges = [way for way in training_controls.WAYS if way != "experts"]
    assert max(mean[kind][way] for kind in ("other-fresh", "matched-fresh") for way in merges) == 19
    assert [mean["matched-fresh"][way] for way in ("paper", "ta-s")] == [0, 0]
    assert max(mean["matched"][way] for way in merges) == 24
    assert round(100 * mean["cross-sigmoid"]["paper"] / mean["cross-sigmoid"]["experts"]) == 66
    quirks = next(row for row in rows if row["kind"] == "quirks")
    assert max(abs(int(quirks[way].rpartition(": ")[2])) for way in training_controls.WAYS) == 3


def test_what_the_page_of_libero_says_of_fast_2_is_in_the_rows():
    rows = json.loads((MEASUREMENTS / "libero_frames.json").read_text(encoding="utf-8"))["rows"]
    times = [row["simplified"] for row in rows]
    shares = [100 * row["simplified"] / row["culled"] for row in rows]
    said = (
        f"{min(times):.0f} to {max(times):.0f} ms with the profile `fast-2`, {min(shares):.0f} to {max(shares):.0f} %"
    )
    assert said in (ROOT / "docs/libero.md").read_text(encoding="utf-8")


def test_the_tables_of_libero_s_experts_and_merges_count_the_committed_episodes():
    for benchmark in (libero_experts, libero_merges, libero_plus):
        name = benchmark.__name__.rpartition(".")[2]
        rows = json.loads((MEASUREMENTS / f"{name}.json").read_text(encoding="utf-8"))["rows"]
        assert benchmark.rows_of(pd.read_parquet(MEASUREMENTS / f"{name}.parquet")) == rows


def test_what_the_page_of_libero_says_of_experts_is_in_the_rows():
    found = json.loads((MEASUREMENTS / "libero_experts.json").read_text(encoding="utf-8"))["rows"]
    rate = {
        (row["policy"], row["axis"]): {
            suite: row[suite].partition(" [")[0] for suite in (*libero_experts.SUITES.values(), "all")
        }
        for row in found
    }
    experts, replay, blank = (
        rate[key] for key in (("experts", "clean"), ("replay", "clean"), ("experts", "blank-instruction"))
    )
    low = min(int(experts[suite].split()[0]) for suite in ("Spatial", "Object", "Goal"))
    for said in (
        f"succeed in {experts['all']}**, in Spatial, Object and Goal in {low} to 100 %, in Long in {experts['Long']}",
        f"open loop, solves {replay['all']}**: {replay['Object']} in Object and {replay['Goal']} in Goal",
        f"In Long it is {replay['Long']}, in Spatial {replay['Spatial']}",
        f"without any, {blank['Goal']} do",
        f"Goal's expert has {rate['random-base', 'clean']['Goal']}, on the zoo's {experts['Goal']}",
        f"{blank['Object'].removesuffix(' %')} and {blank['Spatial']} succeed without an instruction",
    ):
        assert said in (ROOT / "docs/libero.md").read_text(encoding="utf-8")
    frame = pd.read_parquet(MEASUREMENTS / "libero_experts.parquet")
    assert set(frame.seed) == set(range(libero_experts.STATES)) == set(range(20))
    assert "On the first twenty stored states of each task:" in (ROOT / "docs/libero.md").read_text(encoding="utf-8")
    assert frame[frame.axis == "wrong-goal"].status.value_counts().to_dict() == {"failure": 100}


def test_what_the_page_of_libero_says_of_standard_images_and_more_steps_is_in_the_rows():
    rows = pd.read_parquet(MEASUREMENTS / "libero_checks.parquet")
    won = rows[rows.status == "success"]
    count = won.groupby("check").size()
    bottle = won[(won.check == "standard") & won.task.str.contains("goal-2-")]
    page = " ".join((ROOT / "docs/libero.md").read_text(encoding="utf-8").split())
    assert set(rows.groupby("check").size()) == {60}
    assert f"solves {count['standard']} of 60, the wine bottle {len(bottle)} of 10" in page
    assert f"solved {count['steps-15000']} of 60 such placements, after 6,000 {count['steps-6000']}" in page
    assert f"with a hundred of each task it solved {count['demonstrations-100']}" in page


def test_what_the_page_of_libero_says_of_merges_is_in_the_rows():
    rows = json.loads((MEASUREMENTS / "libero_merges.json").read_text(encoding="utf-8"))["rows"]
    page = " ".join((ROOT / "docs/libero.md").read_text(encoding="utf-8").split())
    by_policy = {row["policy"]: row for row in rows}

    def rate(policy, column="all"):
        return by_policy[policy][column].partition(" [")[0]

    routed = [name for name in by_policy if name in libero_merges.ROUTED]
    assert {by_policy[name]["routed"] for name in routed} == {"100 / 100 / 100 / 100 %"}
    two, four = "magnitude-2-routed", "none-4"
    assert f"keep {rate(two, 'kept')} of the experts' success, four bits each {rate(four, 'kept')}" in page
    long = [rate(policy, "Long") for policy in (two, four, "experts")]
    assert f"in Long: {long[0].removesuffix(' %')} and {long[1]} instead of {long[2]}" in page
    vectors = {name: rate(f"{name}-s") for name in ("ties", "knots", "ta", "wudi", "tsv")}
    assert (
        f"TIES+S has {vectors['ties']}, KnOTS+S {vectors['knots']}, TA+S {vectors['ta']}, WUDI+S {vectors['wudi']} and "
        f"TSV+S {vectors['tsv']}"
    ) in page
    averaged = [rate(f"{operator}-s-averaged-trunk") for operator in ("tsv", "ties", "ta")]
    paper = [
        np.mean([int(text) for text in libero_merges.PAPER[f"{operator}-s-averaged-trunk"].split(" / ")])
        for operator in ("tsv", "ties", "ta")
    ]
    assert (
        f"TSV+S has {averaged[0]}, TIES+S {averaged[1]} and TA+S {averaged[2]}, where the paper has "
        f"{paper[0]:.0f}, {paper[1]:.0f} and {paper[2]:.0f} %"
    ) in page
    unmasked = ["mean", *libero_merges.OPERATORS]
    assert {rate(name) for name in unmasked} == {"0 %"}
    played = pd.read_parquet(MEASUREMENTS / "libero_merges.parquet").groupby("policy").size()
    assert set(played[unmasked]) == {24 * libero_merges.UNMASKED_STATES} == {240}
    assert set(played.drop(unmasked)) == {24 * libero_experts.STATES} == {480}
    assert f"of each expert, keeps {rate('emr', 'kept')}**" in page
    assert f"Of Long it keeps nearly nothing ({rate('emr', 'Long')})" in page
    assert f"of each task vector, has {rate('ties-published-s')} with masks" in page


def test_what_the_page_of_libero_says_of_routers_is_in_the_rows():
    rows = json.loads((MEASUREMENTS / "libero_routers.json").read_text(encoding="utf-8"))["rows"]
    page = " ".join((ROOT / "docs/libero.md").read_text(encoding="utf-8").split())
    for row in rows:
        for instruction in ("read", "hidden"):
            rates = libero_routers.rates_of(instruction, row[f"decisions, {instruction}"])
            assert {name: row[name] for name in rates} == rates
    by_router = {row["router"]: row for row in rows}
    for fitted in ("calibrated", "nearest-centroid"):
        assert {by_router[fitted][name].partition(" ")[0] for name in ("read", "hidden")} == {"100.0"}
    paper = [row for row in rows if row["router"].startswith("paper-")]
    right = [float(row[name].partition(" ")[0]) for row in paper for name in ("read", "hidden")]
    suites = {row[f"suites, {name}"] for row in paper for name in ("read", "hidden")}
    assert f"merge, {min(right):.0f} to {max(right):.0f} % are right, and at most {max(suites)} suites; chance" in page
    values = [row[f"decisions, {name}"] for row in paper if ":" not in row["router"] for name in ("read", "hidden")]
    most = min(max(map(one.count, one)) / len(one) for one in values)
    assert f"that expert gets at least {100 * most:.0f} % of them" in page
    energy = [round(float(by_router["delta-energy"][name].split()[0])) for name in ("read", "hidden")]
    assert f"`delta-energy` is right in {energy[0]} and {energy[1]} %" in page
    labelled = [float(by_router["self-trained"][name].partition(" ")[0]) for name in ("read", "hidden")]
    assert f"is right in {labelled[0]:.0f} %, and in {labelled[1]:.0f} % without the instruction" in page
    hidden = by_router["self-trained"]["decisions, hidden"]
    given: dict[str, set[str]] = {}
    for suite, choice in zip(libero_routers.suites_of(hidden), hidden, strict=True):
        given.setdefault(suite, set()).add(libero_routers.NAMES[int(choice)])
    assert (given["object"], given["goal"]) == ({"libero-10"}, {"libero-spatial"})


def test_what_the_page_of_liberoplus_says_of_experts_is_in_the_rows():
    rows = {
        row["plus_axis"]: {name: str(text).partition(" [")[0] for name, text in row.items()}
        for row in json.loads((MEASUREMENTS / "libero_plus.json").read_text(encoding="utf-8"))["rows"]
    }
    own = json.loads((MEASUREMENTS / "libero_experts.json").read_text(encoding="utf-8"))["rows"]
    (clean,) = (row["all"].partition(" [")[0] for row in own if (row["policy"], row["axis"]) == ("experts", "clean"))
    merges = json.loads((MEASUREMENTS / "libero_merges.json").read_text(encoding="utf-8"))["rows"]
    kept = {row["policy"]: row["kept"].partition(" [")[0] for row in merges}
    every = rows.pop("all")
    found = {axis: int(row["experts"].split()[0]) for axis, row in rows.items()}
    named = {axis: int(row["named"].split()[0]) for axis, row in rows.items() if row["named"]}
    same = [found[axis] for axis in named]
    page = (ROOT / "docs/libero-plus.md").read_text(encoding="utf-8")
    for said in (
        f"falls from {clean} in LIBERO itself to {every['experts']}**",
        f"other starts of the arm and other words ({found['robot']} %), least with noise ({found['noise']} %)",
        f"keep {every['kept']} [",
        f"in LIBERO itself {kept['magnitude-2-routed']}; four bits of each expert keep {every['none-4-kept']} [",
        f"there {kept['none-4']}. The router",
        f"in {every['routed']} of the episodes",
        f"{min(named.values())} to {max(named.values())} % instead of {min(same)} to {max(same)} % in the same",
    ):
        assert said in page
    assert found["robot"] == found["language"] == min(found.values())
    assert found["noise"] == max(found.values())


def test_rates_of_routers_under_shifts_are_those_of_the_committed_decisions():
    for row in json.loads((MEASUREMENTS / "shifted_routing.json").read_text(encoding="utf-8"))["rows"]:
        rates = shifted_routing.rates(row["decisions"], sorted(shifted_routing.SENTENCES))
        assert {shift: row[shift] for shift in shifted_routing.SHIFTS} == rates


def test_the_matrix_of_simulators_counts_the_oracles_episodes():
    rows = json.loads((MEASUREMENTS / "oracles.json").read_text(encoding="utf-8"))["rows"]
    matrix = (ROOT / "README.md").read_text(encoding="utf-8")
    robosuite = "[robosuite 1.5](docs/robosuite.md)"
    for title, name in (("ManiSkill 3", "maniskill"), ("PyBullet (panda-gym)", "pybullet"), (robosuite, "robosuite")):
        played = [row for row in rows if row["task"].startswith(name)]
        won, every = (f"{sum(row[key] for row in played):,}" for key in ("successes", "episodes"))
        tasks = f"{len({row['task'].partition('@')[0] for row in played})}"
        tasks += ", three of them with six arms, [two with two](docs/two-arms.md)" if title == robosuite else ""
        tasks += ", [two with two arms](docs/two-arms.md)" if name == "maniskill" else ""
        assert f"| {title} | {tasks} | all; {won} of {every}" in matrix


def test_what_the_page_says_of_answers_on_a_gpu_is_in_the_rows():
    rows = json.loads((MEASUREMENTS / "gpu_answers.json").read_text(encoding="utf-8"))["rows"]
    large = {row["batch"]: row for row in rows if "qwen" in row["network"]}
    page = " ".join((ROOT / "docs/performance.md").read_text(encoding="utf-8").split())
    alone, core = 1000 / large[1]["gpu"], 1 / large[1]["core"]
    said = (
        f"an answer takes {alone:.0f} ms instead of {core:.0f} s, and in batches of 32 there are {large[32]['gpu']:.0f}"
    )
    assert said in page


def test_the_table_of_runs_on_a_gpu_counts_the_committed_episodes_and_the_page_says_what_they_share():
    rows = json.loads((MEASUREMENTS / "gpu_runs.json").read_text(encoding="utf-8"))["rows"]
    played = pd.read_parquet(MEASUREMENTS / "gpu_runs.parquet")
    of = {place: played[played.place == place] for place in gpu_runs.PLACES}
    counted = [gpu_runs.compared(frame, of["core"]) for frame in of.values()]
    assert counted == [{name: row[name] for name in counted[0]} for row in rows]
    both = of["core"].merge(of["gpu"], on=["policy", "task", "seed"])
    assert len(both) == 100
    assert not (both.actions_hash_x == both.actions_hash_y).any()
    merged = both[both.policy == "merged"]
    assert (merged.inferred_task_x == merged.inferred_task_y).all()


def test_the_table_of_libero_s_oracles_counts_the_committed_episodes():
    rows = json.loads((MEASUREMENTS / "libero_oracles.json").read_text(encoding="utf-8"))["rows"]
    assert libero_oracles.rows_of(pd.read_parquet(MEASUREMENTS / "libero_oracles.parquet")) == rows


def test_the_table_of_tasks_counts_the_committed_episodes():
    rows = json.loads((MEASUREMENTS / "oracles.json").read_text(encoding="utf-8"))["rows"]
    bounds = {row["task"]: (row["step_mm"], row["turn_rad"]) for row in rows}
    assert oracles.rows_of(pd.read_parquet(MEASUREMENTS / "oracles.parquet"), bounds) == rows


def test_the_table_of_training_controls_counts_the_committed_episodes():
    rows = json.loads((MEASUREMENTS / "training_controls.json").read_text(encoding="utf-8"))["rows"]
    assert training_controls.rows_of(pd.read_parquet(MEASUREMENTS / "training_controls.parquet")) == rows


def test_controls_keep_the_committed_episodes_of_other_policies_only_if_they_were_played_whole():
    committed = pd.read_parquet(MEASUREMENTS / "training_controls.parquet")
    whole = committed[committed.policy == "quirks-paper-0"].assign(status="success")
    mixed = training_controls.with_committed(whole, committed)
    assert len(mixed) == len(committed)
    assert set(mixed[mixed.policy == "quirks-paper-0"].status) == {"success"}
    assert training_controls.with_committed(whole.head(3), committed).equals(whole.head(3))


def test_the_page_names_the_machines_that_played_the_controls():
    rows = pd.read_parquet(MEASUREMENTS / "training_controls.parquet")
    earlier = rows.policy.str.match(r"cross-sigmoid-(fresh-)?(experts|signs|ta-s|paper)-\d")
    assert rows[earlier].machine.unique().tolist() == ["2 cores of Intel(R) Xeon(R) Processor"]
    assert rows[~earlier].machine.unique().tolist() == ["2 cores of AMD EPYC"]
    page = (ROOT / "docs/mergevla.md").read_text(encoding="utf-8")
    assert "the first two rows on an Intel Xeon, the others on an AMD EPYC" in " ".join(page.split())


def test_what_the_case_study_says_first_is_counted_in_its_rows():
    rows = json.loads((MEASUREMENTS / "mergevla.json").read_text(encoding="utf-8"))["rows"]
    loss, interval = next(row for row in rows if row["task"] == "loss by merging, points")["merged"].split(" ", 1)
    episodes = pd.read_parquet(MEASUREMENTS / "mergevla.parquet")
    rate = (episodes.status == "success").groupby(episodes.policy, observed=True).mean()
    blind = 100 * (rate["experts"] - rate["merged-instruction-hidden"])
    page = (ROOT / "docs/mergevla.md").read_text(encoding="utf-8")
    each = sorted(int(row["experts"].split()[0]) for row in rows[:9])
    assert each[1] >= 95
    assert f"Eight of the nine experts succeed in 95 % or more, PandaPush's in {each[0]} %;" in page
    assert f"loses {loss[1:]} points {interval} to its nine experts, and {blind:.1f} in all" in page
    assert f"now loses [{loss[1:]} points](mergevla.md)" in (ROOT / "docs/robustness.md").read_text("utf-8")


def test_what_the_page_says_of_the_screening_beside_its_findings_is_counted_in_its_rows():
    rows = pd.read_parquet(ROOT / "docs/reports/screening/episodes.parquet")
    page = " ".join((ROOT / "docs/robustness.md").read_text(encoding="utf-8").split())
    won = rows.assign(won=rows.status == "success").groupby(["policy", "axis", "severity"]).won
    kept = (rows[(rows.policy == "experts") & (rows.severity == 2)].status == "success").mean()
    assert f"the zoo's nine experts keep {kept:.0%} over all axes".replace("%", " %") in page
    reworded = [f"{won.mean()[policy, 'instruction'].mean():.0%}" for policy in ("merged", "experts")]
    assert won.size()["merged", "instruction"].sum() == 180
    merged, experts = (rate.replace("%", " %") for rate in reworded)
    assert f"the merged policy succeeds in {merged}, the experts in {experts}." in page
    clean = rows[rows.axis == "clean"].set_index(["policy", "task", "seed"]).actions_hash.rename("clean_hash")
    same = rows.join(clean, on=["policy", "task", "seed"]).eval("actions_hash == clean_hash")
    assert f"bit-identical in all {same[rows.axis == 'again'].sum()} pairs" in page
    assert same[rows.axis == "again"].all()
    acts = {"action-delay", "action-noise", "dynamics", "object-position", "robot-start"}
    assert same[(rows.policy == "oracle") & ~rows.axis.isin(acts)].all()
    found = (ROOT / "docs/reports/screening/README.md").read_text(encoding="utf-8")
    loss, levels = re.findall(r"merged: \+(.*) percentage points .* all (\d+) perturbed", found)[0]
    clean_loss = re.findall(r"merged: \+(.*) percentage points lost against experts, clean", found)[0]
    assert f"{loss.replace(' ', ' points ', 1)} ({levels} levels, 90 % interval)" in page
    assert f"in the clean condition, {clean_loss.replace(' ', ' points ', 1)} (18 axes" in page
    for pattern, said in (
        (r"experts: .* drops .*(along \d+ of \d+ axes)", "Success drops {}: the"),
        (r"experts: .*object-position \(\d+ % (to \d+ %) at", "and {} [8, 29] with objects 7 cm outside"),
        (r"experts: .*camera-bump \((\d+ % to \d+ %) at 5 cm\)", "the experts' from {} with cameras displaced by 5 cm"),
        (r"policy failed first under (\d+ of \d+ axes)", "**The policy fails first** along {},"),
        (r"another one (.*?), clean", "experts still reach the old goal in {} of the episodes"),
    ):
        assert said.format(*re.findall(pattern, found)) in page


def test_the_page_says_how_much_of_an_experts_episode_its_behaviour_takes():
    rows = json.loads((MEASUREMENTS / "behaviour_cost.json").read_text(encoding="utf-8"))["rows"]
    fast, fast_2 = (
        100 * max(row["share"] for row in rows if f"`{profile}`" in row["policy"]) for profile in ("fast", "fast-2")
    )
    assert max(fast, fast_2) < 2.0
    said = f"up to {fast:.2f} % with the profile `fast`, and up to {fast_2:.2f} % with `fast-2`"
    assert said in (ROOT / "docs/failures.md").read_text(encoding="utf-8")


def test_how_many_delayed_episodes_oracles_solve_is_counted_in_the_rows_of_the_screening():
    rows = pd.read_parquet(ROOT / "docs/reports/screening/episodes.parquet")
    delayed = rows[(rows.policy == "oracle") & (rows.axis == "action-delay")]
    solved = delayed.status.eq("success").groupby(delayed.severity).agg(["sum", "count"])
    said = f"oracles solve {solved['sum'][2]} of {solved['count'][2]} episodes at its severity 2 (100 ms)"
    text = " ".join((ROOT / "docs/robustness.md").read_text(encoding="utf-8").split())
    assert f"{said} and {solved['sum'][4]} at 4 (300 ms)" in text


@pytest.mark.parametrize("instruction", ["read", "hidden"])
def test_rates_of_routers_are_those_of_the_committed_decisions(instruction):
    measured = json.loads((MEASUREMENTS / "routers.json").read_text(encoding="utf-8"))
    for row in measured["rows"]:
        right = [int(choice) == place // len(SEEDS) for place, choice in enumerate(row[f"decisions, {instruction}"])]
        assert len(right) == 9 * len(SEEDS)
        assert row[instruction] == interval(right)
