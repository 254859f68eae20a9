"""Suites, configurations and run documents: whatever a file holds, it is read or refused in plain lines."""

import json
from functools import cache
from pathlib import Path

import yaml
from hypothesis import example, strategies as st

from robogauntlet.orchestrator.registry import SHIPPED, load_registry
from robogauntlet.results.run_document import RunError, read_run
from robogauntlet.suites.loading import SuiteError, load_config, load_suite
from tests.fuzz.damage import damaged_bytes, damaged_value, fuzzed, in_one_line
from tests.results.synthetic import document

SUITES = [(SHIPPED / f"{name}.yaml").read_text(encoding="utf-8") for name in ("mergevla", "robustness-smoke")]
CONFIG = {
    "environments": {"null": {"python": "3.11", "requirements": ["numpy==2.0"], "installer": "pip", "inherit": True}}
}
RUN = json.loads(document(3).model_dump_json())


def written(value):
    """YAML of a value as bytes; text that UTF-8 cannot write is escaped."""
    return yaml.safe_dump(value).encode("utf-8", "surrogatepass")


@cache
def registry():
    return load_registry()


@fuzzed(st.sampled_from(SUITES).flatmap(lambda text: damaged_bytes(text.encode())))
@example(damaged=b"a: &a [*a]")
@example(damaged=b"[" * 10_000)
def test_a_suite_of_damaged_bytes(tmp_path, damaged):
    suite(tmp_path, damaged)


@fuzzed(st.sampled_from(SUITES).flatmap(lambda text: damaged_value(yaml.safe_load(text))).map(written))
@example(damaged=b'"a\\nb": 1\nname: s')
def test_a_suite_of_damaged_values(tmp_path, damaged):
    suite(tmp_path, damaged)


@fuzzed(damaged_bytes(written(CONFIG)) | damaged_value(CONFIG).map(written))
def test_a_damaged_configuration(tmp_path, damaged):
    file = tmp_path / "config.yaml"
    file.write_bytes(damaged)
    refusable(lambda: load_config(file, list(registry().simulators)), SuiteError)


@fuzzed(damaged_bytes(json.dumps(RUN).encode()) | damaged_value(RUN).map(lambda value: json.dumps(value).encode()))
@example(damaged=b"[" * 100_000)
def test_a_damaged_run_document(tmp_path, damaged):
    (tmp_path / "run.json").write_bytes(damaged)
    try:
        read_run(tmp_path)
    except RunError as error:
        in_one_line(error)


def suite(folder: Path, content: bytes):
    file = folder / "suite.yaml"
    file.write_bytes(content)
    refusable(lambda: load_suite(file, registry()), SuiteError)


def refusable(read, kind):
    """Read something, which may be refused by a kind of error whose message has a line for each mistake."""
    try:
        read()
    except kind as error:
        for line in str(error).splitlines():
            in_one_line(line, 700)
