"""`make audit` says which pins have known vulnerabilities, and never that there are none if nobody answered."""

import json
import sys

import pytest
from packaging.version import Version

from scripts import audit

ANSWER = """
import json, sys
pins = open(sys.argv[-1]).read().split()
packages = [dict(zip(("name", "version"), pin.split("==")), vulns=[]) for pin in pins]
{change}
print(json.dumps({{"dependencies": packages}}))
"""
HOLE = {"id": "PYSEC-1", "fix_versions": ["99.0"], "aliases": ["CVE-2026-0001"]}


@pytest.fixture
def audited(tmp_path, capsys):
    """Runs the audit with a program in place of pip-audit; returns exit code and lines."""

    def run(script):
        (tmp_path / "pip_audit.py").write_text(script)
        code = audit.main([sys.executable, str(tmp_path / "pip_audit.py")])
        return code, capsys.readouterr().out.splitlines()

    return run


def test_all_pins_and_those_of_lerobots_environment_are_looked_up(audited):
    code, lines = audited(ANSWER.format(change=""))
    assert code == 0
    counts = {name: len(pins) for name, pins in audit.pins_by_origin().items()}
    assert counts["constraints.txt"] > 150
    assert counts["policies/lerobot/policy.py"] > 10
    assert lines == [f"{name}: no known vulnerability in {count} packages" for name, count in counts.items()]
    pins = [pin for pins in audit.pins_by_origin().values() for pin in pins]
    assert [pin for pin in pins if pin.count("==") != 1] == []


def test_a_known_vulnerability_is_named_with_the_version_that_fixes_it(audited):
    change = f"[p.update(vulns=[{json.dumps(HOLE)}]) for p in packages if p['name'] == 'ray']"
    code, lines = audited(ANSWER.format(change=change))
    assert code == 1
    assert lines[0] == "constraints.txt: 1 known vulnerabilities"
    assert lines[1].startswith("  ray 2.")
    assert lines[1].endswith(": PYSEC-1, CVE-2026-0001; fixed in 99.0")


@pytest.mark.parametrize("who", ["p", "p if p['name'] == 'ray' else {}"])
def test_packages_that_the_service_does_not_know_count_as_not_checked(audited, who):
    code, lines = audited(ANSWER.format(change=f"[({who}).update(skip_reason='not found') for p in packages]"))
    assert code == 3
    assert lines[0].startswith("constraints.txt: NOT CHECKED, the vulnerability service answered for ")


def test_a_service_that_cannot_be_reached_is_no_clean_result(audited):
    code, lines = audited("import sys; sys.exit('ConnectionError: name not resolved')")
    assert code == 3
    assert lines[0].endswith("could not reach its vulnerability service: ConnectionError: name not resolved")


def test_lerobots_environment_has_the_transformers_that_loads_no_code_of_a_configuration():
    # CVE-2026-4372 is fixed in 5.3.0.
    pins = dict(pin.split("==") for pin in audit.pins_by_origin()["policies/lerobot/policy.py"])
    assert Version(pins["transformers"]) >= Version("5.3.0")
    assert "kernels" not in pins
