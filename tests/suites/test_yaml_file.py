"""YAML of strangers is refused in one line before it costs time or memory."""

import sys
import time

import pytest
from hypothesis import example, given, strategies as st

from robogauntlet.suites.yaml_file import MAX_BYTES, YamlError, parse_yaml, read_yaml

REFUSED = {
    "aliases": ("a: &a [x]\nb: [*a, *a]", "expected plain YAML without aliases, found *a"),
    "merges": ("a: &a {x: 1}\nb: {<<: *a}", "expected plain YAML without aliases, found *a"),
    "values": ("[" + "1," * 100_001 + "]", "expected at most 100000 values"),
    "nesting": ("[" * 60 + "]" * 60, "expected at most 50 lists and mappings inside each other"),
    "nesting beyond the stack": ("[" * 100_000, "expected at most 50 lists and mappings inside each other"),
    "digits": ("a: " + "9" * 5000, "expected a number of at most 100 characters, found 5000"),
    "hexadecimal digits": ("a: 0x" + "f" * 5000, "expected a number of at most 100 characters, found 5002"),
    "base 60": ("a: 1" + ":1" * 100_000, "expected a number of at most 100 characters, found 200001"),
    "surrogate": ('a: "\\ud800"', "expected text that UTF-8 can write, found the character U+D800"),
    "surrogate in a key": ('"\\udfff": 1', "expected text that UTF-8 can write, found the character U+DFFF"),
    "escaped NUL": ('a: "x\\0"', "expected text that UTF-8 can write, found the character U+0000"),
    "NUL": ("a: \0", "not YAML: character U+0000 at offset 3, expected printable text"),
    "object": ("!!python/name:os.system x", "found the tag 'tag:yaml.org,2002:python/name:os.system'"),
    **{
        f"tag {text}": (f"a: {text}", f"expected plain YAML without tags, found the tag '{tag}")
        for text, tag in {
            "!!binary aGk=": "tag:yaml.org,2002:binary'",
            "!!str [a]": "tag:yaml.org,2002:str'",
            "!!bool x": "tag:yaml.org,2002:bool'",
            '!!int ""': "tag:yaml.org,2002:int'",
            '!!int "-"': "tag:yaml.org,2002:int'",
            '!!float ""': "tag:yaml.org,2002:float'",
            "!!map x": "tag:yaml.org,2002:map'",
            "[!own {b: 1}]": "!own'",
            "! b": "!'",
        }.items()
    },
    "value key": ("a: =", "could not determine a constructor"),
    "merge key": ("a: <<", "could not determine a constructor"),
    "binary number without digits": ("a: 0b_", "not YAML: "),
    "date": ("a: 2020-01-01", "found a date ('2020-01-01'); put it in quotes"),
    "list as key": ("? [1]\n: 2", "found unhashable key"),
    "two documents": ("a: 1\n--- \nb: 2", "not YAML: but found another document"),
    "tab": ("a:\n\t- b", "not YAML: found character '\\t' that cannot start any token"),
}


@pytest.mark.parametrize(("text", "line"), REFUSED.values(), ids=REFUSED)
def test_a_text_beyond_the_bounds_is_refused_at_once(text, line):
    began = time.monotonic()
    with pytest.raises(YamlError) as caught:
        parse_yaml(text)
    assert line in str(caught.value)
    assert "\n" not in str(caught.value)
    assert time.monotonic() - began < 60


def test_plain_values_are_read_with_their_lines():
    document = parse_yaml("a: {x: [1, 2.5, true, null, y]}\nb: &b {z: 1}\n")
    assert document.data == {"a": {"x": [1, 2.5, True, None, "y"]}, "b": {"z": 1}}
    assert document.lines["b", "z"] == 2


def test_keys_that_occur_twice_are_named_with_their_line():
    assert parse_yaml("a: 1\nb: {c: 1,\n c: 2}\na: 3\n").duplicates == ((3, "c"), (4, "a"))


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("x" * 300, "cannot be read: File name too long"),
        ("a\0b", f"cannot be read: {'stat: ' if sys.version_info >= (3, 13) else ''}embedded null "),
        (".", "expected a file, this is a directory"),
        ("none.yaml", "no such file; did you mean "),
        ("one.yaml/x", "cannot be read: Not a directory"),
        ("/dev/zero", "cannot be read: a device, no regular file"),
        ("long.yaml", f"expected a file of at most {MAX_BYTES} bytes, this has {MAX_BYTES + 1}"),
        ("latin.yaml", "expected UTF-8 text, found byte 0xff at offset 1"),
    ],
)
def test_a_file_that_cannot_be_read_is_one_line(tmp_path, name, line):
    (tmp_path / "one.yaml").write_text("a: 1")
    (tmp_path / "long.yaml").write_text("#" * (MAX_BYTES + 1))
    (tmp_path / "latin.yaml").write_bytes(b"a\xff")
    with pytest.raises(YamlError) as caught:
        read_yaml(tmp_path / name, "a file")
    assert str(caught.value).startswith(line)


@given(st.text(":-[]{},#'\"|>&*!%@`~?\t\n\x85\ufeff ab1é", max_size=40))
@example("a: {b: [1, 'c']}\nd: |\n  e\nf:\n- g\n")
def test_a_text_is_read_or_refused_in_the_same_words_with_and_without_libyaml(text):
    def read():
        try:
            return parse_yaml(text)
        except YamlError as error:
            return str(error), error.line

    with_it = read()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("yaml.__with_libyaml__", False)
        assert read() == with_it
