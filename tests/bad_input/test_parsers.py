"""Every parser of what a person writes or keeps: texts that it refuses, with what it says of them in a line."""

import struct
from functools import partial
from pathlib import Path

import pytest

from robogauntlet.orchestrator.demonstrations.variation import Variation
from robogauntlet.orchestrator.ray_runtime.cluster import NoCluster, check_address
from robogauntlet.orchestrator.runs.composition import compose_plan
from robogauntlet.orchestrator.schedules.schedule import read_schedules
from robogauntlet.policies import catalog
from robogauntlet.policies.contract import PolicyError
from robogauntlet.policies.references import read_options, read_reference
from robogauntlet.policies.training.dataset import open_datasets
from robogauntlet.results.run_document import RunError, read_run
from robogauntlet.results.store.database import StoreError
from robogauntlet.results.store.episode_store import Store, check_place
from robogauntlet.suites.loading import load_config
from robogauntlet.suites.schema import PolicyEntry
from robogauntlet.support.errors import UserError
from robogauntlet_mergevla.checkpoints.merge_experts import read_experts
from tests.bad_input.folder import write
from tests.bad_input.forged import document_with
from tests.bad_input.refusals import SECRET, not_refused

HUGE = 10**18
RUN = "runs/monday/run.json"
CARD = "experts/null-Reach/card.json"
WEIGHTS = "experts/null-Reach/model.safetensors"
INFO = "data/Reach/meta/info.json"
TASKS = "data/Reach/meta/tasks.parquet"
FRAMES = "data/Reach/data/chunk-000/file-000.parquet"
ERRORS = (UserError, RunError, StoreError, PolicyError, NoCluster)
NO_JSON = ("", "{", "[]", "null", "5", "[" * 100_000)
CONDITIONS = {
    "nois": "unknown condition 'nois'; did you mean 'noise'?",
    "noise@9": "condition noise@9: expected a severity from 0.01 to 5, got 9",
    "noise:2": "condition 'noise:2': expected noise@2",
    "noise=2": "condition 'noise=2': expected noise@2",
    "noise@1.001": "condition 'noise@1.001': expected a severity in hundredths, such as 1, got 1.001",
    "noise@1e1": "condition 'noise@1e1': expected clean, AXIS or AXIS@SEVERITY[,SEVERITY], such as",
    "noise@2,2": "duplicate condition 'noise@2'",
    "@2": "condition '@2': expected clean, AXIS or AXIS@SEVERITY[,SEVERITY]",
}
REFERENCES = {
    "randm": "got 'randm'; did you mean 'random'?",
    "nowhere/checkpoint": "expected openpi://HOST:PORT or another server's address (robogauntlet list",
    "text": "expected openpi://HOST:PORT",
    "notes": "got 'notes', a folder without a checkpoint: no kind of policy knows what is in it",
    "http://127.0.0.1:1": "got 'http://127.0.0.1:1'; did you mean one of openpi://127.0.0.1:1, openvla+http://127.0.0.1:1?",
    "lerobot/act_pusht": "got 'lerobot/act_pusht'; did you mean 'lerobot:lerobot/act_pusht'?",
    "zoo:nothing": "expected the name of a shipped checkpoint after 'zoo:', got",
    "zoo:../base": "expected the name of a shipped checkpoint after 'zoo:', got",
    "zoo:": "expected the name of a shipped checkpoint after 'zoo:', got",
    "python:": "got 'python:'; did you mean 'python'?",
    "python:json": "expected python:MODULE:NAME, or option callable: MODULE:NAME, got 'json'",
    "python:json:decoder:x": "expected python:MODULE:NAME, or option callable: MODULE:NAME, got 'json:decoder:x'",
    "python:../x:Policy": "expected python:MODULE:NAME, or option callable: MODULE:NAME, got '../x:Policy'",
    "openpi:": "got 'openpi:'; did you mean 'openpi'?",
    "vla-eval://": "address: expected vla-eval://HOST:PORT, got",
    "gr00t://host": "address: expected gr00t://HOST:PORT, got",
    "openvla+http://host/\xe4": "address: expected openvla+http://HOST:PORT/act, got",
    "xpolicylab://": "address: expected xpolicylab://HOST:PORT, got",
    "openvla+ftp://host": "address: expected openvla+http://HOST:PORT/act, got",
    "vla-eval:openpi://host:1": "address: expected vla-eval://HOST:PORT, got",
    "openpi://": "address: expected openpi://HOST:PORT, got",
    "openpi://host:port": "address: expected openpi://HOST:PORT, got",
    "openpi://host:99999": "address: expected openpi://HOST:PORT, got",
    "openpi:http://host:1": "address: expected openpi://HOST:PORT, got",
    f"openpi://u:{SECRET}@host:1": "address: expected openpi://HOST:PORT, got",
}
OPTIONS = {
    "seed": "--option: expected NAME=VALUE, got 'seed'",
    "=1": "--option: expected NAME=VALUE, got '=1'",
    "a=[": "--option a: not YAML",
    "a=!!python/name:os.system": "--option a: expected plain YAML without tags, found the tag",
    "a=2026-01-01": "--option a: expected plain YAML, found a date",
}
SERVER_OPTIONS = {
    "token_variable=WANDB_API_KEY": "token_variable: expected ROBOGAUNTLET_POLICY",
    "timeout_s=-1": "timeout_s: expected greater than 0, got -1",
    "timeout_s=.nan": "timeout_s: expected a finite number, got nan",
    "convention=nope": "convention: expected 'robogauntlet', 'libero', 'so101', 'aloha', 'droid' or 'native'",
}
VARIED = {
    "nois": "--vary nois: unknown axis 'nois'; did you mean 'noise'",
    "noise@9": "--vary noise@9: expected a severity from 0.01 to 5, got 9",
    "noise@0": "--vary noise@0: expected a severity from 0.01 to 5, got 0",
    "noise@1,2": "--vary noise@1,2: expected one severity, such as noise@2, got 2",
    "noise noise@3": "--vary noise@3: expected each axis once, got 'noise' twice",
    "clean": "--vary clean: expected an axis to be varied, 'clean' is no axis",
    "noise@": "--vary noise@: expected",
    "blind": "--vary blind: expected an axis to be varied, 'blind' is a control",
    "instruction": "'instruction' is for evaluation: policies must not see its sentences",
    "noise+blur@2": "--vary noise+blur@2: expected",
}
SCHEDULES = {
    **{
        f"n: {{suite: smoke, cron: '@daily', timezone: {zone}}}": "expected one of the IANA list such as Europe/Berlin"
        for zone in ("Mars", "europe/berlin", "../etc/passwd", "UTC+25")
    },
    **{
        f"{name}: {{suite: smoke, cron: '@daily'}}": "expected letters, digits, '-' and '_', at most 63"
        for name in ("'a b'", "../x", "é", "n" * 64, "_x")
    },
    "n: {suite: smoke, cron: '@daily', arguments: x}": "n.arguments: Input should be a valid list",
}
CONFIGURATIONS = {
    "5": "expected a mapping with environments",
    "a: [": "not YAML",
    "environment: {}": "unknown key 'environment'; did you mean 'environments'?",
    "environments: 5": "environments: expected a mapping, found a whole number (5)",
    "environments: {nul: {python: '3.11'}}": "unknown simulator 'nul'",
    "environments: {'null': {python: '3.1.2'}}": 'expected a version such as "3.11", in quotes',
    "environments: {'null': {requirements: ['-e .']}}": "expected a requirement of pip",
    "environments: {'null': {inherit: maybe}}": "inherit",
    "x" * 1_000_001: "expected a configuration file of at most 1000000 bytes",
    b"\xff": "expected UTF-8 text, found byte 0xff",
}
URLS = {
    "nonsense": "not a store URL: nonsense; expected sqlite:///FILE or postgresql+psycopg://HOST:PORT/DATABASE",
    f"u:{SECRET}@host": "not a store URL; expected sqlite:///FILE",
    "file:///x": "expected an sqlite or postgresql URL, got file",
    "sqlite:////nonexistent/x": "/nonexistent/x: ",
    "sqlite:///text": "expected a store, this file is something else",
    "sqlite:///notes": "expected a store, this is a directory",
    f"postgresql+psycopg://u:{SECRET}@127.0.0.1:x/db": "not a store URL; expected sqlite:///FILE",
    f"postgresql+psycopg://u:{SECRET}@127.0.0.1:1/db": "postgresql+psycopg://u:***@127.0.0.1:1/db: connection failed",
    f"postgresql+nothing://u:{SECRET}@h/db": "postgresql+nothing://u:***@h/db",
    "sqlite:///x?timeout=abc": "timeout=abc: expected a number of seconds",
    "sqlite:///x?timeout=nan": "timeout=nan: expected a number of seconds",
    "sqlite:///x?timeout=-1": "timeout=-1: expected a number of seconds",
    "sqlite:///x?timeout=1&timeout=2": "expected the parameter timeout once",
    "sqlite:///x?check_same_thread=maybe": "check_same_thread=maybe: expected true or false",
    "sqlite:///x?timeuot=5": "unknown parameter 'timeuot'; known: timeout, uri,",
    "sqlite:///x?mode=ro": "expected uri=true beside mode=ro",
    "sqlite:///file:x?mode=memory&uri=true": "mode=memory: expected one of ro, rw, rwc",
    "sqlite://": "expected the file of a store, as in sqlite:///FILE; a store in memory loses its rows",
}
PLACES = dict.fromkeys(
    (
        *(f"sqlite:///new/{name}" for name in ("run.json", "report.html", "media/x.sqlite", "../new/run.json")),
        "sqlite:///file:new/run.json?uri=true",
    ),
    "a store outside of the run folder",
)
DOCUMENTS = {
    **dict.fromkeys((*NO_JSON, "\0"), "expected a run document of format 1"),
    b"\xff\xfe": "cannot be read: 'utf-8' codec can't decode byte 0xff",
}
FIELDS = [
    *(("format", value) for value in (2, "one", None)),
    *(("started_at", value) for value in (1e20, -1, "yesterday")),
    *(("elapsed_s", value) for value in (1e300, -1, float("nan"))),
    *(("media_left_out", value) for value in (2**63, -1, 1.5)),
    *(("plan", value) for value in ("all", [{}], None)),
    *(("plan:0:planned", value) for value in (2**63, 2**53 + 1, -1, 1.5, "many")),
    *(("finished_at", -1e20), ("shared_workers", -1), ("skipped", {"x" * 600: "absent"}), ("run_id", "x" * 3_000_000)),
    *(("plan:0:severity", value) for value in (2**63, -1, "strong")),
    *(("plan:0:policy", value) for value in (None, "x" * 501)),
    *(("suite", value) for value in ("s", {})),
    *(("suite:seeds:count", value) for value in (2**63, 0)),
    *(("provenance", value) for value in (5, {"cores": -1}, {"packages": {"a": 1}}, {"nope": 1})),
    *(
        (name, value)
        for name, value in {"status": "done", "origin": "mine", "decided": [{}], "workers": {"a": 2**63}}.items()
    ),
    *((name, "x" * length) for name, length in {"suite_text": 4_000_001, "reason": 8_001}.items()),
    ("nope", {"a": {"b": "c" * 10_000}}),
    ("x\x1b[31m\n" * 50, 1),
]
CARDS = [
    ("format", 2, "expected metadata of format 1, got"),
    ("kind", "merged", "expected a checkpoint of one network, got a merged checkpoint"),
    ("kind", ["x"], "expected a checkpoint of one network"),
    *(("architecture", value, "architecture") for value in (5, None, {}, {"name": 5})),
    *(("architecture:image_size", value, "image_size") for value in (0, HUGE, "big", 1.5)),
    *(("architecture:chunk_length", value, "chunk_length") for value in (0, HUGE, None)),
    ("architecture:cameras", "wrist", "cameras"),
    ("architecture:language:width", HUGE, "width"),
    ("architecture:language:heads", 0, "heads: expected greater than or equal to 1"),
    *(("statistics", value, "statistics") for value in (5, {"null/Reach": 5}, {"null/Reach": {}})),
    ("statistics:null/Reach:action:q01", [1], "q01"),
    ("statistics:null/Reach:action:q01", ["a"] * 7, "q01"),
    ("statistics:null/Reach:action:q99", [float("nan")] * 7, "q99"),
    *(("action_steps", value, f"expected a valid integer, got {value!r}") for value in ("all", 2.0, True)),
    *(("action_steps", value, "expected 1 to 8 action steps, the length of a chunk, got") for value in (0, 9)),
    *((name, 5, f"{name}: expected a valid string, got 5") for name in ("base_hash", "tensor_hash")),
    ("lora", {"rnk": 2}, "lora"),
    *(("lora", {"rank": value}, "expected a LoRA rank of 1") for value in (0, HUGE)),
    *(("base", value, "base") for value in (5, "../../nowhere", "/dev/null", "a\0b")),
    ("base", "../../../../../../etc", "expected card.json in"),
    ("base", "x" * 300, "expected its base at 'xxx"),
    *((name, "0" * 64, "hash") for name in ("tensor_hash", "base_hash")),
    ("nope", 1, "nope"),
    ("metrics", {"loss": "low"}, "metrics"),
]
HEADERS = dict.fromkeys(
    (
        struct.pack("<Q", 2**62) + b"{}",
        struct.pack("<Q", 1000) + b"{}",
        b"",
        b"1234567",
        struct.pack("<Q", 4) + b"nope",
        struct.pack("<Q", 2) + b"[]",
        struct.pack("<Q", 100_000) + b"[" * 100_000,
        b"\x80\x04\x95\x00\x00\x00\x00\x00\x00\x00\x00\x00.",
    ),
    "safetensors",
)
INFOS = [
    *(("codebase_version", value, "expected codebase_version v3.0, got") for value in ("v2.1", None)),
    ("total_frames", "many", "info.json"),
    *(("total_frames", value, "in order, got 24") for value in (-1, HUGE, 23)),
    *(("total_episodes", value, "episodes") for value in (-1, HUGE, 3)),
    ("fps", "many", "expected a LeRobot dataset: ValueError"),
    ("fps", 0, "fps"),
    *(("features", value, "info.json") for value in ({}, [], None)),
    *(
        ("features:observation.images.third_person:shape", value, "info.json: expected a LeRobot dataset: ")
        for value in ([0, 0, 3], [HUGE] * 3, [-16, 16, 3], "big", [None])
    ),
]


def _in_file(name, parse, place="."):
    """A parser of what is written into a file: text, bytes, or what becomes of its bytes."""

    def parsed(content):
        before = Path(name).read_bytes() if Path(name).exists() else None
        write(Path(), {name: content})
        try:
            parse(Path(place))
        finally:
            Path(name).unlink() if before is None else Path(name).write_bytes(before)

    return parsed


def _forged(rows):
    return {partial(document_with, place, value): says for place, value, says in rows}


def _another(place):
    """What is said of a run document with another value at this place; a name with control characters is escaped."""
    first = place.partition(":")[0]
    return f"expected a run document of format 1, got another one ({first if first.isidentifier() else ''}"


def _server(text):
    catalog.spec("openpi", {"address": "ws://127.0.0.1:1", **read_options([text])})


def _reference(text):
    entry = read_reference(text)
    catalog.spec(entry.kind, entry.options)
    catalog.digest(entry.kind, entry.options)


_run = _in_file(RUN, read_run, "runs/monday")
_checkpoint = partial(_in_file, parse=lambda folder: read_experts(["experts/null-Reach"]))
_dataset = partial(_in_file, parse=lambda folder: open_datasets([Path("data/Reach")]))
_random = PolicyEntry(name="random", kind="random")
PARSERS = {
    "condition": (lambda text: compose_plan([_random], ["null/Reach"], seeds=1, conditions=[text]), CONDITIONS),
    "policy": (_reference, REFERENCES),
    "option": (lambda text: read_options([text]), OPTIONS),
    "option of a server": (_server, SERVER_OPTIONS),
    "varied axes": (lambda text: Variation.read(text.split()), VARIED),
    "schedules": (_in_file("schedules.yaml", read_schedules, "schedules.yaml"), SCHEDULES),
    "configuration": (_in_file("config.yaml", lambda path: load_config(Path("config.yaml"), ["null"])), CONFIGURATIONS),
    "address of a cluster": (
        check_address,
        dict.fromkeys(
            ("head", "head:port", "head:0", "head:99999", "ray://head:1", ":6379", "a:6379:1"), "expected HOST:PORT"
        ),
    ),
    "store's URL": (lambda url: Store.open(url, "run"), URLS),
    "store's place": (partial(check_place, Path("new")), PLACES),
    "run document": (_run, DOCUMENTS),
    "field of a run document": (_run, _forged((*row, _another(row[0])) for row in FIELDS)),
    "checkpoint": (_checkpoint(CARD), dict.fromkeys((*NO_JSON, b"\xff"), "card.json")),
    "field of a checkpoint": (_checkpoint(CARD), _forged(CARDS)),
    "weights": (_checkpoint(WEIGHTS), HEADERS),
    "dataset": (_dataset(INFO), dict.fromkeys((*NO_JSON, b"\xff"), "info.json")),
    "field of a dataset": (_dataset(INFO), _forged(INFOS)),
    "tasks of a dataset": (_dataset(TASKS), dict.fromkeys(("text", "", "PAR1"), "cannot be read")),
    "frames of a dataset": (_dataset(FRAMES), dict.fromkeys(("text", "", "PAR1"), "cannot be read")),
}
"""Parser, and texts with what is said of them."""


@pytest.mark.parametrize(("parse", "texts"), PARSERS.values(), ids=PARSERS)
def test_a_bad_text_is_refused_in_one_line(good_files, monkeypatch, parse, texts):
    monkeypatch.chdir(good_files[0])
    assert not_refused(parse, texts, ERRORS) == []
