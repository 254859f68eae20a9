"""Run folders, their documents and stores, and URLs of stores, that are not what they should be."""

from functools import partial

from tests.bad_input.case import SECRET, Case, table
from tests.bad_input.folder import EPISODE, SUITE
from tests.bad_input.forged import document_with

HUGE = 2**63
RUN = "runs/monday/run.json"
STORE = "runs/monday/episodes.sqlite"
READERS = (
    *(
        "report {}",
        "cite {}",
        "replay abc --run {}",
        "verify {}",
        "compare {}",
        "compare runs/monday {}",
        "compare --gate {}",
    ),
    *("compare --gate runs/monday {}", "export {}", "log {} --to mlflow", "report {} --table csv"),
)
"""Every command that reads a run folder."""
NO_RUNS = {
    "nowhere": "nowhere: expected a run folder, it does not exist",
    "text": "text: expected a run folder, this is a file",
    "notes": "notes: expected a run folder, it has no run.json",
}
DOCUMENTS = {
    **dict.fromkeys(
        ("", "{", "[]", "null", "5", '"run"', "[" * 100_000, "{}", "\0"), "expected a run document of format 1"
    ),
    b"\xff\xfe": "cannot be read: 'utf-8' codec can't decode byte 0xff",
    b"\x1f\x8b\x08": "cannot be read: 'utf-8' codec can't decode byte 0x8b",
}
FIELDS = [
    *(("format", value) for value in (2, "one", None)),
    *((time, value) for time in ("started_at", "finished_at") for value in (1e20, -1, "yesterday", [], HUGE)),
    *((time, value) for time in ("elapsed_s", "media_s") for value in (1e300, -1, "long", float("nan"), float("inf"))),
    *(("media_left_out", value) for value in (HUGE, -1, 1.5, "some")),
    *(("status", value) for value in ("done", 1, None)),
    *(("plan", value) for value in ("all", {}, [5], [{}], None)),
    *(("plan:0:planned", value) for value in (HUGE, 10**30, -1, "all", 0.5)),
    *(("plan:0:severity", value) for value in (HUGE, -1, "strong")),
    *(("plan:0:policy", value) for value in (5, None, "x" * 501, ["p"])),
    *(("suite", value) for value in ([], "s", None, {}, 5)),
    *(("suite:seeds:count", value) for value in (HUGE, 0, "many")),
    *(("suite:policies", value) for value in ([], "p", [5])),
    *(("suite_text", value) for value in (5, None, "x" * 4_000_001)),
    *(("workers", value) for value in ({"a": HUGE}, [], 5)),
    *(("provenance", value) for value in (5, {"cores": -1}, {"packages": {"a": 1}}, {"nope": 1})),
    *(("origin", value) for value in ("mine", 5)),
    *(("reason", value) for value in ("x" * 8_001, 5)),
    *(("decided", value) for value in ([{}], 5)),
    *(("nope", value) for value in (1, {"a": {"b": "c" * 10_000}})),
    ("x\x1b[31m\n" * 50, 1),
]
STORES = {
    b"": "expected a store, this file is empty; restore it from a copy, or remove it",
    b"x": "expected a store, this file is something else",
    b"x" * 10_000: "expected a store, this file is something else",
    b"SQLite format 3\0" + b"\0" * 5_000: "expected a store",
}
URLS = {
    "nonsense": "not a store URL: nonsense; expected sqlite:///FILE or postgresql+psycopg://HOST:PORT/DATABASE",
    f"u:{SECRET}@host": "not a store URL; expected sqlite:///FILE",
    "mysql://x/y": "mysql://x/y: expected an sqlite or postgresql URL, got mysql",
    "file:///x": "expected an sqlite or postgresql URL, got file",
    "sqlite:////nonexistent/x": "/nonexistent/x: ",
    "sqlite:///text": "expected a store, this file is something else",
    "sqlite:///byte": "expected a store, this file is something else",
    "sqlite:///notes": "expected a store, this is a directory",
    f"postgresql+psycopg://u:{SECRET}@127.0.0.1:x/db": "not a store URL; expected sqlite:///FILE",
    f"postgresql+psycopg://u:{SECRET}@127.0.0.1:1/db": "postgresql+psycopg://u:***@127.0.0.1:1/db: connection failed",
    f"postgresql+psycopg://127.0.0.1:1/db?user=u&password={SECRET}": "db?password=***&user=u: connection failed",
    f"postgresql+nothing://u:{SECRET}@h/db": "postgresql+nothing://u:***@h/db",
}
STORE_USERS = (
    *("run suite.yaml --out new --store '{}'", "report runs/monday --store '{}'", "verify runs/monday --store '{}'"),
    *("history --history '{}'", "serve --port 0 --history '{}'"),
    *("compare --accept monday --history '{}'", "forget monday --history '{}'"),
)
QUERIES = table(
    ("report runs/monday --condition clean", "--condition: expected with --table"),
    (
        "report runs/monday --table latex --figures svg",
        "expected --table, which writes nothing, or --figures, got both",
    ),
    ("report runs/monday --table latex --condition nois", "--condition: the run has no condition 'nois'; known: clean"),
    ("report runs/monday --table latex --condition clean@9", "the run has no condition 'clean@9'"),
    (
        "replay abc --run runs/monday",
        "runs/monday: no episode abc; ids are listed by: robogauntlet list episodes runs/monday",
    ),
    ("report runs/monday --table latex --condition noise:2", "condition 'noise:2': expected noise@2"),
    ("export runs/monday --format lerobot-dataset --condition noise=2 --out new", "'noise=2': expected noise@2"),
    (
        "replay --policy p --run runs/monday",
        "expected an episode's id, or --policy, --task and --seed; got no id and no",
    ),
    (f"replay {EPISODE} --seed 1 --run runs/monday", "expected an episode's id or --seed, got both"),
    ("replay --policy x --task maniskill/PushCube-v1 --seed 1 --run runs/monday", "the run has no policy 'x'"),
    (
        "replay --policy p --task maniskill/PushCube-v1 --seed 9 --run runs/monday",
        "expected one such episode, the run has 0",
    ),
    ("replay --policy '*' --task '*' --seed 1 --run runs/monday", "expected one such episode, the run has 2; they are"),
    ("list episodes nowhere", "nowhere: expected a run folder, it does not exist"),
    ("list episodes runs/monday --condition noise:2", "condition 'noise:2': expected noise@2"),
    ("list episodes runs/monday --policy x", "the run has no policy 'x'"),
    ("list --policy p", "--policy: expected with episodes, as in robogauntlet list episodes RUN --policy"),
    (
        "list tasks runs/monday",
        "expected no run, got 'runs/monday'; for its episodes: robogauntlet list episodes runs/monday",
    ),
    ("list policies --task null/Reach", "--task: expected with tasks or episodes, got policies"),
    (f"replay {EPISODE} --with nois@2 --run runs/monday", "unknown axis 'nois'; did you mean 'noise'?"),
    (f"replay {EPISODE} --with noise --run runs/monday", "--with noise: expected one severity, such as noise@2"),
    (f"replay {EPISODE} --with noise=2 --run runs/monday", "--with noise=2: expected noise@2"),
    (f"replay {EPISODE} --with noise@7 --run runs/monday", "expected a severity from 0.01 to 5, got 7"),
    (f"replay {EPISODE} --without noise --run runs/monday", "--without noise: the episode is under clean"),
    ("replay % --run runs/monday", "runs/monday: no episode %"),
    ("replay abc --run runs/monday --store sqlite:///none", "there is no such file"),
    (
        "verify runs/monday --store sqlite:///none",
        "none: expected the store of the run in runs/monday, there is no such file",
    ),
    ("compare runs/monday:x runs/monday:p", "runs/monday: the run has no policy 'x'; known: p, q"),
    ("compare runs/monday:p", "expected two policies, RUN:A RUN:B; runs/monday:p names one"),
    ("compare runs/monday:p runs/tuesday", "runs/monday:p names one and runs/tuesday names none"),
    ("compare runs/monday --policy x", "runs/monday: the run has no policy 'x'; known: p, q"),
    ("compare runs/monday --format junit", "--format junit: expected text, json or markdown"),
    ("compare runs/monday:p runs/monday:q --policy p", "--policy: expected with a whole run only"),
    ("compare runs/monday --out nowhere/x", "nowhere/x: expected a file in an existing folder"),
    ("compare runs/monday --out notes", "notes: expected a file to write, this is a folder, no regular file"),
    *(
        (typed.format(file), f"{file}: expected a new file, or {what} to replace, this is another file; name a new one")
        for typed, what in (
            ("compare runs/monday --out {}", "a comparison"),
            ("compare runs/monday runs/tuesday --format junit --out {}", "a comparison"),
            ("compare --gate runs/tuesday runs/monday --format json --out {}", "a comparison"),
            ("mergevla routing zoo --json {}", "results of routers"),
        )
        for file in ("runs/monday/episodes.sqlite", "runs/monday/run.json", "suite.yaml", "run.zip", "text")
    ),
    ("compare runs/monday --out /dev/zero", "/dev/zero: expected a file to write, this is a device, no regular file"),
    ("compare --gate runs/tuesday --policy x", "runs/tuesday: the run has no policy 'x'; known: p, q"),
    ("compare --gate runs/monday", "expected a complete earlier run of suite 'synthetic' beside it, found none"),
    (
        "compare --gate runs/monday --store sqlite:///x",
        "with --store, name the run to compare it with: robogauntlet compare runs/monday BASELINE --gate",
    ),
    ("history x", "no run with a policy 'x'; known: p, q"),
    ("history p --task nope", "no run with a policy 'p' on 'nope'"),
    ("history --suite syntetic", "no run of a suite 'syntetic'; did you mean 'synthetic'?"),
    ("history --out x.svg", "--out: expected the name of the policy to plot"),
    ("history p --out x.pdf", "--out: expected a file that ends in .svg or .html, got 'x.pdf'"),
    ("history p --out nowhere/x.svg", "nowhere/x.svg: expected a file in an existing folder"),
    ("compare --all nope", "no run of a suite 'nope'; known: synthetic"),
    ("compare --accept nope", "no run 'nope' in the history; see: robogauntlet history"),
    ("compare --accept %", "no run '%' in the history"),
    ("compare --accept 0", "no run '0' in the history"),
    ("compare --accept 0123456", "no run '0123456' in the history"),
    ("compare --gate runs/monday runs/monday", "runs/monday: expected another run to compare with, this is the run"),
    ("compare runs/monday runs/../runs/monday", "expected another run to compare with, this is the run itself"),
    ("forget nope", "no run 'nope' in the history"),
    ("forget 0", "no run '0' in the history"),
    ("forget 0123 --delete", "no run '0123' in the history"),
    (
        "export runs/monday --task x",
        "expected --task, --condition, --status and --limit with --format lerobot-dataset only",
    ),
    (
        "export runs/monday --policy p",
        "expected --policy with --format lerobot, vla-eval or lerobot-dataset only, got run",
    ),
    ("export runs/monday --format csv --out text", "text: expected a new file, this one exists"),
    ("export runs/monday --format parquet --out notes", "notes: expected a new file, this one exists"),
    ("export runs/monday --out text", "text: expected a new file, there is one already"),
    ("export runs/monday --out notes", "notes: expected a new file, there is one already"),
    ("export runs/monday --format lerobot --policy x", "no episode of a policy 'x'; the run has p, q"),
    ("export runs/monday --format lerobot-dataset --policy x --out new", "the run has no policy 'x'"),
    ("export runs/monday --format lerobot-dataset --condition nois --out new", "the run has no condition 'nois'"),
    ("export runs/monday --format lerobot-dataset --status failure --out new", "no episode matches the options"),
    (
        "log runs/monday --to mlflow --store sqlite:///none",
        "expected the store of the run in runs/monday, there is no such file",
    ),
    ("serve --host 0.0.0.0 --port 0", "ROBOGAUNTLET_TOKEN"),
    ("serve --host nowhere.invalid --port 0", "nowhere.invalid"),
    (
        "serve --public-url ftp://x --port 0",
        "--public-url: expected an address such as https://lab.example.org without a path, got",
    ),
    ("serve --public-url nonsense --port 0", "--public-url: expected an address such as https://lab.example.org"),
)
RUNS = [
    *(
        Case(f"run suite.yaml --out new --address {address}", f"--address {address}: expected HOST:PORT")
        for address in ("head", "head:port", "head:0", "head:99999", "ray://head:1", ":6379", "head:6379:1")
    ),
    Case("run suite.yaml --out new --address 127.0.0.1:1", "expected the head of a Ray cluster, nothing answers there"),
    Case("run", "expected a suite, or --policy and --task; got no --policy and no --task"),
    Case("run --policy random", "expected a suite, or --policy and --task; got no --task"),
    Case("run --task null/Reach --seeds 1", "expected a suite, or --policy and --task; got no --policy"),
    Case("run suite.yaml --condition noise", "--condition: expected --policy and --task instead of a suite file"),
    Case("run --policy random --task null/Reech", "unknown task 'null/Reech'; did you mean 'null/Reach'?"),
    Case("run --policy randm --task null/Reach", "did you mean 'random'?"),
    Case("run --policy random --policy random --task null/Reach", "duplicate policy 'random'"),
    *(
        Case(f"run --policy random --task null/Reach --condition {condition}", says)
        for condition, says in {
            "nois": "unknown condition 'nois'; did you mean 'noise'?",
            "noise@9": "condition noise@9: expected a severity from 0.01 to 5, got 9",
            "noise:2": "condition 'noise:2': expected noise@2",
            "noise=2": "condition 'noise=2': expected noise@2",
            "noise@1.001": "condition 'noise@1.001': expected a severity in hundredths, such as 1, got 1.001",
            "noise@x": "condition 'noise@x': expected clean, AXIS or AXIS@SEVERITY[,SEVERITY], such as noise@2,4",
            "noise@": "condition 'noise@': expected clean, AXIS or AXIS@SEVERITY[,SEVERITY]",
            "noise@٣": "condition 'noise@٣': expected clean, AXIS or AXIS@SEVERITY[,SEVERITY]",
            "noise@-1": "condition 'noise@-1': expected clean, AXIS or AXIS@SEVERITY[,SEVERITY]",
            "noise@1e1": "condition 'noise@1e1': expected clean, AXIS or AXIS@SEVERITY[,SEVERITY]",
            "noise@99999999999999999999": "expected clean, AXIS or AXIS@SEVERITY[,SEVERITY]",
            "noise@2,2": "duplicate condition 'noise@2'",
            "@2": "condition '@2': expected clean, AXIS or AXIS@SEVERITY[,SEVERITY]",
        }.items()
    ),
    Case("run suite.yaml --require nul --out new", "nul: the suite does not use this simulator; did you mean 'null'?"),
    Case("run suite.yaml --require pybullet --out new", "pybullet: the suite does not use this simulator"),
    Case("run suite.yaml --out text", "text: expected a folder, this is a file"),
    Case("run suite.yaml --out text/run", "text/run: expected a folder, this is a file"),
    Case("run suite.yaml --out runs/monday", "it holds a run of suite 'synthetic', not 's'; give another folder"),
    Case(
        "run suite.yaml --out jdir",
        "jdir/run.json: expected a run document, got a folder, no regular file",
        {"jdir/run.json": None},
    ),
    Case("run suite.yaml --out odd", "expected a run document of format 1", {"odd/run.json": "{"}),
    Case("run suite.yaml --out new", "not a store URL", variables={"ROBOGAUNTLET_STORE": "nonsense"}),
    Case("run suite.yaml --out new", "not a store URL", variables={"ROBOGAUNTLET_HISTORY": f"x:{SECRET}@y"}),
    Case("run big.yaml --out new", "found 999999999", {"big.yaml": SUITE + "workers: 999999999\n"}),
    Case("report", "no run under runs/; name one", {"runs/monday/run.json": None, "runs/tuesday/run.json": None}),
    Case(
        "compare --gate", "no run under runs/; name one", {"runs/monday/run.json": None, "runs/tuesday/run.json": None}
    ),
    Case("verify runs/monday", "expected the store of the run in runs/monday, there is no such file", {STORE: None}),
    Case(
        "history p --out mine.svg",
        "mine.svg: expected a new file, or a plot of a history to replace, this is another file; name a new one",
        {"mine.svg": "<svg/>"},
    ),
    Case(
        "axes sheet noise --out mine.png",
        "mine.png: expected a new file, or a contact sheet to replace, this is another file; name a new one",
        {"mine.png": b"\x89PNG\r\n\x1a\n"},
    ),
    *(
        Case(f"run suite.yaml --out new {option} 'sqlite:///new/{name}'", "a store outside of the run folder")
        for option in ("--store", "--history")
        for name in ("run.json", "report.html", "media/x.sqlite", "../new/run.json")
    ),
    Case(
        "run suite.yaml --out new --store 'sqlite:///file:new/run.json?uri=true'", "a store outside of the run folder"
    ),
    *(
        Case(f"{verb} '{url}'", says)
        for verb in ("run suite.yaml --out new --store", "report runs/monday --store", "history --history")
        for url, says in {
            "sqlite:///x?timeout=abc": "timeout=abc: expected a number of seconds",
            "sqlite:///x?timeout=nan": "timeout=nan: expected a number of seconds",
            "sqlite:///x?timeout=-1": "timeout=-1: expected a number of seconds",
            "sqlite:///x?timeout=1&timeout=2": "expected the parameter timeout once",
            "sqlite:///x?check_same_thread=maybe": "check_same_thread=maybe: expected true or false",
            "sqlite:///x?timeuot=5": "unknown parameter 'timeuot'; known: timeout, uri,",
            "sqlite:///x?mode=ro": "expected uri=true beside mode=ro",
            "sqlite:///file:x?mode=memory&uri=true": "mode=memory: expected one of ro, rw, rwc",
            "sqlite://": "expected the file of a store, as in sqlite:///FILE; a store in memory loses its rows",
        }.items()
    ),
    Case("report runs/odd", "run.json: expected a run document, got a folder", {"runs/odd/run.json/x": ""}),
]
CASES = [
    *(Case(verb.format(place), says) for verb in READERS for place, says in NO_RUNS.items()),
    *(Case("report runs/monday", says, {RUN: text}) for text, says in DOCUMENTS.items()),
    *(
        Case("report runs/monday", "expected a run document of format 1", {RUN: partial(document_with, place, value)})
        for place, value in FIELDS
    ),
    *(
        Case(verb.format("runs/monday"), says, {STORE: content})
        for verb in ("report {}", "verify {}", "compare {}", "export {} --out new", "export {} --format csv --out new")
        for content, says in STORES.items()
    ),
    *(Case(user.format(url), says) for user in STORE_USERS for url, says in URLS.items()),
    *QUERIES,
    *RUNS,
]
