"""Whole verbs: a mistake is answered at once in a line that says what was expected, and changes nothing."""

import shlex
import signal
import sys
from contextlib import contextmanager

import pytest

from tests.bad_input import folder
from tests.bad_input.folder import EPISODE, SUITE
from tests.bad_input.refusals import SECRET, differences
from tests.bad_input.test_suites import suite

DEADLINE_S = 60
"""Time after which a command hangs; the slowest of these takes a second."""
FREE = "name: s\nneeds: policy\ntasks: [null/Reach]\nseeds: {count: 1}\n"
PLAY = "run --policy {} --task null/Reach --seeds 1 --out new"
MERGE = "mergevla merge experts/null-Reach experts/null-Slow --out new"
TRAIN = "mergevla finetune data/Reach --base base --out new --steps 1 --batch-size 2 --rank 2"
SEARCH = "search disturbance --policy random --task null/Reach --out new --budget"
NO_RUN = "nowhere: expected a run folder, it does not exist"
NO_NULL = "null simulator (no physics) does not let its cameras be adjusted"
READERS = (
    *(
        "report {}",
        "report {} --cite",
        "replay abc --run {}",
        "replay --verify {}",
        "compare {}",
        "compare runs/monday {}",
        "compare --gate {}",
    ),
    *("export {}", "export {} --tracker mlflow", "resume {}", "list episodes {}"),
)
TYPED = {
    **{verb.format("nowhere"): NO_RUN for verb in READERS},
    # what is typed for something else
    "run why --policy oracle": "'oracle' is its gate or baseline already, name another policy: the suite needs a pol",
    "run --policy random --task libero/spatial-0": "unknown task 'libero/spatial-0'; did you mean 'libero/spatial-0-",
    "run suiet": "no such file, and no shipped suite of that name; did you mean 'suite.yaml'?",
    "run runs/monday": "this is a run folder; to continue its run: robogauntlet run suites/synthetic.yaml --out runs",
    "run --policy oracle --task null/Reach --option image_size=224": "it is a key of suites: --image-size",
    "run suite.yaml --episodes 10": "No such option: --episodes (Possible options: --seeds)",
    "list axes noise --task null/Reach": "--task: expected with --delivered",
    "list axes lighting": "unknown axis 'lighting'; did you mean one of illuminance, light-direction, ",
    "rnu suite.yaml": "No such command 'rnu'",
    "check polcy random": "No such command 'polcy'. Did you mean 'policy'?",
    "list extra": "No such command 'extra'",
    "report runs/monday --table nope": "Invalid value for '--table': 'nope' is not one of 'latex'",
    "replay": "expected an episode's id, or --policy, --task and --seed; got no id and no",
    # suites
    "plan --check nowhere.yaml": "nowhere.yaml: no such file",
    "plan --check notes": "expected a suite file, this is a directory",
    "plan --check run.zip": "expected UTF-8 text",
    "plan --check text/suite.yaml": "cannot be read: Not a directory",
    "plan suite.yaml --policy 'z*'": "no policy 'z*'",
    "plan suite.yaml --task null/Raise": "the suite has no task 'null/Raise'",
    "plan suite.yaml --seeds 3": "expected 1 to 2 seeds, got 3",
    "plan suite.yaml --out runs/monday": "it holds a run of suite 'synthetic', not 's'",
    "plan suite.yaml --rate 80": "--rate: expected with --width, whose interval it is for",
    "plan suite.yaml --width 5 --discordance 20": "--discordance: expected with --detect, whose pairs it is about",
    "plan suite.yaml --detect 10 --discordance 5": "--discordance 5: expected at least the difference to detect, 10",
    "plan suite.yaml --detect 10": "--detect: expected two policies or more to compare, suite 's' has random",
    "plan suite.yaml --width 5 --out nope": "nope: expected a run of the suite, whose episodes say what to assume",
    "env create null --suite nowhere": "no such file, and no shipped suite of that name",
    # runs
    "run suite.yaml --workers 0": "--workers: expected auto, or a number from 1 to 10000",
    "run --policy random --policy random --task null/Reach": "duplicate policy 'random'",
    "run --policy random --task null/Reach --condition nois": "unknown condition 'nois'; did you mean 'noise'?",
    "run suite.yaml --out text/run": "text/run: expected a folder, this is a file",
    "run suite.yaml --out runs/monday": "it holds a run of suite 'synthetic', not 's'; give another folder",
    "run suite.yaml --out new --address 127.0.0.1:1": "expected the head of a Ray cluster, nothing answers there",
    "run suite.yaml --out new --store sqlite:///new/run.json": "a store outside of the run folder",
    "run suite.yaml --out new --history sqlite:///new/run.json": "a store outside of the run folder",
    # policies
    PLAY.format("ws://127.0.0.1:1"): "policy server ws://127.0.0.1:1",
    PLAY.format("python:nomodule:Policy"): "expected a module 'nomodule' in",
    PLAY.format(
        "experts --image-size 96"
    ): "policy 'experts' does not fit: the policy was made for 16 px images, the suite",
    PLAY.format(
        "zoo:experts"
    ): "policy 'zoo-experts' does not fit: it cannot act in null/Reach; it can in maniskill/PullCube-v1, ",
    PLAY.format("random --option sead=1"): "policy 'random' has no option 'sead'",
    "serve policy randm --port 0": "got 'randm'; did you mean 'random'?",
    "serve policy random --host nowhere.invalid --port 0": "nowhere.invalid",
    "serve policy random --host 0.0.0.0 --port 0": "ROBOGAUNTLET_TOKEN",
    "check policy random --task null/Reech": "unknown task 'null/Reech'; did you mean 'null/Reach'?",
    "new policy json": "a Python module 'json' exists already; choose another name",
    "new policy a-b": "expected a name of up to 40 small letters, digits and single underscores",
    "new policy mine --out notes": "notes exists; give another folder with --out",
    "new policy mine --out text/x": "text/x cannot be created: Not a directory",
    "new demonstrations null/Reach --out text": "text: expected a folder",
    "new demonstrations null/Reach --out new --episodes 0": "episodes",
    "new demonstrations null/Reach --out new --learner notes": "notes",
    "new demonstrations null/Reach --out new --vary nois": "--vary nois: unknown axis 'nois'; did you mean 'noise'",
    # searches
    f"{SEARCH} 39 --axis noise": "--budget: expected at least 40 episodes for 1 axis on 1 task, got 39",
    f"{SEARCH} 40 --axis noise --axis blur": "--budget: expected at least 100 episodes for 2 axes on 1 task, or fewer",
    f"{SEARCH} 79 --axis noise --task null/Slow": "--budget: expected at least 80 episodes for 1 axis on 2 tasks, go",
    f"{SEARCH} 60000 --axis noise": "--budget: expected at most 50000 episodes per task, got 60000",
    f"{SEARCH} 100 --axis noise@2": "--axis: expected a perturbation axis, got 'noise@2'; did you mean 'noise'?",
    f"{SEARCH} 100 --axis noise --axis noise": "--axis: expected each axis once, got 'noise' twice",
    f"{SEARCH} 100 --axis camera-orbit": f"--axis camera-orbit: null/Reach cannot have it: {NO_NULL}",
    f"{SEARCH} 100 --axis noise --out notes": "notes: expected a new folder or that of a search, it has other files",
    # a run's questions
    "report runs/monday --table latex --condition nois": "--condition: the run has no condition 'nois'; known: clean",
    "report runs/monday --table latex --condition noise:2": "condition 'noise:2': expected noise@2",
    "report runs/monday --store sqlite:///text": "expected a store, this file is something else",
    "replay --verify runs/monday --store sqlite:///none": "none: expected the store of the run in runs/monday, there",
    "replay abc --run runs/monday": "no episode abc; ids are listed by: robogauntlet list episodes runs/monday",
    "replay % --run runs/monday": "runs/monday: no episode %",
    "replay --policy '*' --task '*' --seed 1 --run runs/monday": "expected one such episode, the run has 2; they are",
    "replay --policy x --task maniskill/PushCube-v1 --seed 1 --run runs/monday": "the run has no policy 'x'",
    f"replay {EPISODE} --seed 1 --run runs/monday": "expected an episode's id or --seed, got both",
    "list episodes runs/monday --policy x": "the run has no policy 'x'",
    "list tasks runs/monday": "no task matches 'runs/monday'",
    "list policies --task null/Reach": "No such option: --task",
    "list tasks nul/*": "no task matches 'nul/*'",
    "compare runs/monday --out nowhere/x": "nowhere/x: expected a file in an existing folder",
    "compare runs/monday --out suite.yaml": "suite.yaml: expected a new file, or a comparison to replace, this is an",
    "compare runs/monday --out /dev/zero": "/dev/zero: expected a file to write, this is a device, no regular file",
    "compare runs/monday runs/../runs/monday": "expected another run to compare with, this is the run itself",
    "compare --gate runs/tuesday --policy x": "runs/tuesday: the run has no policy 'x'; known: p, q",
    "compare --gate runs/monday --store sqlite:///x": "with --store, name the run to compare it with: robogauntlet",
    "list runs x": "no run with a policy 'x'; known: p, q",
    "list runs --suite syntetic": "no run of a suite 'syntetic'; did you mean 'synthetic'?",
    f"list runs --history postgresql+psycopg://u:{SECRET}@127.0.0.1:1/db": "u:***@127.0.0.1:1/db: connection failed",
    "compare --all nope": "no run of a suite 'nope'; known: synthetic",
    "compare --gate --all": "expected one of --gate, --all, --accept, --latency, got --gate and --all",
    "compare --all synthetic --margin 0.1": "--margin: expected without --all",
    "compare runs/monday --imported": "--imported: expected with --all",
    "compare --all synthetic --format markdown": "--format markdown: expected text or json with --all",
    "compare --accept": "--accept: expected the run that becomes the baseline",
    "compare --accept %": "no run '%' in the history",
    "list runs --delete": "--delete: expected with --forget RUN",
    "list runs p --forget monday": "POLICY: expected without --forget",
    "list runs --forget 0123 --delete": "no run '0123' in the history",
    "export runs/monday --format csv --media": "expected --media with --format run only, got csv",
    "export runs/monday --format csv --out text": "text: expected a new file, this one exists",
    "import run.zip --out runs/monday": "expected a new folder, there is one already; name another with --out",
    "export runs/monday --project nights": "--project: expected with --tracker",
    "export runs/monday --tracker mlflow --media": "--media: expected without --tracker",
    "plan suite.yaml suite.yaml": "expected one suite, got 2; to check several: robogauntlet plan --check SUITE...",
    "plan --check suite.yaml --width 5": "--width: expected without --check",
    "report runs/monday --cite --table csv": "--table: expected without --cite",
    "replay --verify runs/monday --video x.mp4": "--video: expected without --verify",
    "replay abc --sample 3 --run runs/monday": "--sample: expected with --verify",
    "env list --suite suite.yaml": "--suite: expected with the name of an environment",
    "serve dashboard --host 0.0.0.0 --port 0": "ROBOGAUNTLET_TOKEN",
    "serve dashboard --public-url ftp://x --port 0": "--public-url: expected an address such as https://lab.example.org",
    # schedules, axes, environments, adapters
    "schedule run nightly": "schedules.yaml: no such file",
    "schedule print cron notes": "notes: expected a file of schedules, this is a directory",
    "env create liberro": "unknown simulator 'liberro'; did you mean 'libero'?",
    "env remove '*'": "*: no environment of that name",
    "check adapter null --task Reech": "unknown task 'null/Reech'; did you mean 'null/Reach'?",
    "new adapter my_sim": "expected a name of up to 40 small letters, digits and single dashes",
    "new adapter maniskill": "the simulator 'maniskill' exists already; choose another name",
    # merging and training
    "mergevla pretrain data/Reach --out new --size huge": "expected one of tiny",
    f"{TRAIN} --schedule linear": "schedule: expected",
    f"{TRAIN} --shift 99999": "largest_shift: expected less than or equal to 1024, got 99999",
    f"{MERGE} --lambda nan": "lambda",
    f"{MERGE} --only visio": "got 'visio'; did you mean 'vision'?",
}
WITH_FILES = [
    ("plan --check bad.yaml other.yaml", "bad.yaml\nother.yaml", {"bad.yaml": "5", "other.yaml": "[]"}),
    ("plan bad.yaml", "unknown policy", {"bad.yaml": suite(policies="[oracel]")}),
    (
        "plan --check bad.yaml",
        "axis 'table' is unsupported in null/Reach",
        {"bad.yaml": suite(design="{kind: latin-hypercube, axes: [table, noise], points: 4}")},
    ),
    (
        "plan --check bad.yaml",
        "File name too long",
        {"bad.yaml": suite(policies=f"[{{kind: mergevla, options: {{checkpoint: {'y' * 300}}}}}]")},
    ),
    ("run free.yaml --out new", "free.yaml: the suite needs a policy; add --policy with", {"free.yaml": FREE}),
    ("run bad.yaml --out new", "missing key 'seeds'", {"bad.yaml": SUITE.partition("seeds")[0]}),
    ("run suite.yaml --out odd", "expected a run document of format 1", {"odd/run.json": "{"}),
    ("schedule run m", "no schedule 'm'", {"schedules.yaml": "nightly: {suite: smoke, cron: '@daily'}"}),
    ("report", "no run under runs/; name one", {"runs/monday/run.json": None, "runs/tuesday/run.json": None}),
    ("report runs/odd", "run.json: expected a run document, got a folder", {"runs/odd/run.json/x": ""}),
    (
        "replay --verify runs/monday",
        "expected the store of the run in runs/monday",
        {"runs/monday/episodes.sqlite": None},
    ),
    ("export runs/monday --out new", "expected a store, this file", {"runs/monday/episodes.sqlite": b"x" * 10_000}),
    (
        PLAY.format("python:broken:Policy"),
        "importing 'broken' raised SyntaxError: invalid syntax (broken.py, line 1)",
        {"broken.py": "def Policy(:\n"},
    ),
    (
        PLAY.format("python:ends:Policy"),
        "importing 'ends' raised RuntimeError: at import",
        {"ends.py": "raise RuntimeError('at import')\n"},
    ),
    (
        PLAY.format("python:number.py:Policy"),
        "found none; write number:Policy, without .py",
        {"number.py": "Policy = 5\n"},
    ),
    (PLAY.format("python:number:Policy"), "expected a class or a function, got int", {"number.py": "Policy = 5\n"}),
    (f"{SEARCH} 100 --axis noise --out notes", "its search has another 'policy'", {"notes/search.json": "{}"}),
    (f"{SEARCH} 100 --axis noise --out notes", "notes/search.json: Expecting", {"notes/search.json": "{"}),
]
WITH_VARIABLES = [
    ("run suite.yaml --out new", "not a store URL", {"ROBOGAUNTLET_STORE": "nonsense"}),
    ("run suite.yaml --out new", "not a store URL", {"ROBOGAUNTLET_HISTORY": f"x:{SECRET}@y"}),
    ("plan --check suite.yaml", "nowhere/config.yaml: no such file", {"ROBOGAUNTLET_CONFIG": "nowhere/config.yaml"}),
    ("schedule list --test-message", "ROBOGAUNTLET", {"ROBOGAUNTLET_SMTP_URL": f"smtp://u:{SECRET}@h:port"}),
]
CASES = [
    *((typed, says, {}, {}) for typed, says in TYPED.items()),
    *((typed, says, files, {}) for typed, says, files in WITH_FILES),
    *((typed, says, {}, variables) for typed, says, variables in WITH_VARIABLES),
]
"""What is typed, what is said of it, and files and environment variables that are there."""


@pytest.mark.parametrize(("typed", "says", "files", "variables"), CASES, ids=[case[0][:60] for case in CASES])
def test_a_mistake_is_one_line_and_changes_nothing(run_command, good_files, monkeypatch, typed, says, files, variables):
    place, before = good_files
    monkeypatch.chdir(place)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # Python's own cache, which is no answer to bad input
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    folder.write(place, files)
    expected = folder.content(place) if files else before
    try:
        with deadline(DEADLINE_S):
            done = run_command(*shlex.split(typed))
    finally:
        left = folder.content(place)
        if left != before:
            folder.restore(place, before, left)
    assert [path for path in {**left, **expected} if left.get(path, ...) != expected.get(path, ...)] == []
    assert done.code == 2, done.out + done.err
    answer = done.err[done.err.find("Error: ") :] if done.err.startswith("Usage: ") else done.err
    assert list(differences(answer, says)) == []
    assert SECRET not in done.out + done.err


@pytest.mark.parametrize(
    "typed",
    ["compare --accept nope", "list runs nope", "compare --all nope", "list runs --forget nope --history {new}"],
)
def test_a_mistake_where_no_run_is_yet_makes_no_history(run_command, tmp_path, typed):
    assert run_command(*typed.format(new=f"sqlite:///{tmp_path}/new.sqlite").split()).refusal.startswith("no ")
    assert list(tmp_path.iterdir()) == []


@contextmanager
def deadline(seconds):
    """Ends a block that hangs."""

    def end(*_):
        pytest.fail(f"no answer after {seconds} s")

    before = signal.signal(signal.SIGALRM, end)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
