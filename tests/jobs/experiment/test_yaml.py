"""Experiment files are read by YAML 1.2's core schema, into trees; what cannot be kept is refused with its line."""

from __future__ import annotations

import math
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from jobs.experiment.yaml_schema import plain_scalar, plain_value, to_yaml, visible
from jobs.experiment.yaml_source import MAX_CHARACTERS, MAX_VALUES, SpecError, parse

CORE = {
    "1e-3": 0.001, "1E3": 1000.0, ".5": 0.5, "5.": 5.0, "-1.5e+2": -150.0, "+1": 1, "-0": 0, "012": 12, "08": 8,
    "0o12": 10, "0xfF": 255, ".inf": math.inf, "-.INF": -math.inf, "+.Inf": math.inf, "~": None, "null": None,
    "NULL": None, "": None, "true": True, "False": False, "TRUE": True,
}  # fmt: skip
"""Of the tables in §10.3.2 of https://yaml.org/spec/1.2.2/."""
TEXTS = (
    "on", "off", "yes", "no", "y", "n", "On", "NO", "1_000", "0b11", "1:30", "0x_", "0o8", "-0x10", "0X10", "1e", "e3",
    ".", "1.2.3", "2001-02-30", "2001-12-14t21:59:43.10-05:00", "nUll", "tRUE", ".iNF", "=", "<", "١٢",
)  # fmt: skip
"""What YAML 1.1, or Python, takes for something else, and what is almost a number."""


@pytest.mark.parametrize("text", CORE)
def test_core_schema(text: str) -> None:
    """A plain scalar is what YAML 1.2's core schema says."""
    value = parse(f"a: {text}", "a.yaml").content["a"]
    assert (value, type(value)) == (CORE[text], type(CORE[text]))


@pytest.mark.parametrize("text", TEXTS)
def test_all_else_is_text(text: str) -> None:
    """There is nothing else than null, booleans and numbers: no sexagesimal, no dates, no ``yes``."""
    assert plain_scalar(text) == text


def test_tags_of_the_core_schema() -> None:
    """A value may say of which kind it is."""
    text = '{a: !!str 3, b: !!float 3, c: !!int "3", d: ! 3, e: !!null "", f: !!map {}, g: !!seq [], h: "3"}'
    expected = {"a": "3", "b": 3.0, "c": 3, "d": "3", "e": None, "f": {}, "g": [], "h": "3"}
    assert parse(text, "a.yaml").content == expected


def test_an_alias_is_a_copy() -> None:
    """Nothing in a document stands there twice, so that changing one place changes no other."""
    content = parse("a: &x {b: [1]}\nc: *x\nd: {<<: *x, e: 2}\nf: {<<: [*x, {b: 3, g: 4}], h: 5}", "a.yaml").content
    assert content == {"a": {"b": [1]}, "c": {"b": [1]}, "d": {"b": [1], "e": 2}, "f": {"b": [1], "g": 4, "h": 5}}
    content["a"]["b"].append(2)
    content["a"]["z"] = 1
    assert content["c"] == {"b": [1]}
    assert content["d"] == {"b": [1], "e": 2}


BOMB = "a: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]\n" + "".join(
    f"b{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]\n" for i in range(1, 20)
)
MERGES = "x0: &x0 {a: 1}\n" + "".join(f"x{i}: &x{i} {{<<: *x{i - 1}}}\n" for i in range(1, 400))
REFUSED = {
    "recursive alias": ("a: 1\nb: &x [*x]", "f.yaml:2: found the alias *x within what it stands for"),
    "recursive merge": ("b: &x {<<: *x}", "f.yaml:1: found the alias *x within"),
    "no such anchor": ("b: *x", "f.yaml:1: found the alias *x without an anchor"),
    "billion laughs": (BOMB, "values, aliases written out"),
    "merges without end": (MERGES, "levels"),
    "nested too deeply": ("a: " + "[" * 100_000, "found more than 50 levels"),
    "set": ("a: 1\nb: {c: !!set {x, y}}", "f.yaml:2: b.c: found the tag '!!set' on a mapping"),
    "ordered mapping": ("b: !!omap [x: 1]", "f.yaml:1: b: found the tag '!!omap' on a list"),
    "timestamp": ("b: !!timestamp 2001-01-01", "f.yaml:1: b: found the tag '!!timestamp', expected none, or one of"),
    "binary": ("b: !!binary Yg==", "f.yaml:1: b: found the tag '!!binary'"),
    "Python": ("b: !!python/object/apply:os.system [x]", "f.yaml:1: b: found the tag '!!python/object/apply:os.sys"),
    "local tag": ("b: !mine 3", "found the tag '!mine'"),
    "tag of a key": ("!!timestamp b: 3", "found the tag '!!timestamp'"),
    "empty tag": ("b: !<> 3", "found no valid YAML"),
    "tag that is wrong": ("b: !!int x", "f.yaml:1: b: found 'x' with the tag !!int, expected a whole number"),
    "long integer": ("b: " + "9" * 5000, "b: found 99999999999999999999… (5000 characters), expected a whole"),
    "65 bits": ("b: 9223372036854775808", "expected a whole number of at most 64 bits"),
    "too large": ("b: 1e400", "found 1e400, expected a number between"),
    "too small": ("b: -1e-400", "found -1e-400, expected a number between"),
    "no number": ("a:\n  b: .nan", "f.yaml:2: a.b: found nan, expected a number"),
    "escape sequence": ('b: "\\e[31m"', r"f.yaml:1: b: found '\x1b[31m', expected text without control characters"),
    "escape sequence in a key": ('"\\e[31m": 1', r"found '\x1b[31m', expected text without control"),
    "right to left": ('"\\u202e": 1', r"found the key '\u202e', expected text without control"),
    "key that is a number": ("b: {1: 2}", "f.yaml:1: b: found the key 1, expected text: put it in quotes"),
    "key that is null": ("~: 2", "found the key None, expected text"),
    "key that is a list": ("? [a]\n: b", "found a list or mapping as a key, expected text"),
    "two documents": ("a: 1\n---\nb: 1", "f.yaml:2: found a second document, expected one"),
    "surrogate": ("a: \ud800", "found no valid YAML"),
    "escape out of range": ('a: "\\U00110000"', "found no valid YAML"),
    "version out of range": ("%YAML 99999999999999999999.1\n---\na: 1", "found no valid YAML"),
    "large file": ("a: " + "x" * MAX_CHARACTERS, "characters, expected at most 1,000,000"),
    "many values": ("a: [" + "1," * MAX_VALUES + "]", f"found more than {MAX_VALUES:,} values"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_refused(name: str) -> None:
    """What cannot be read, or not be kept, is one clear line."""
    text, expected = REFUSED[name]
    with pytest.raises(SpecError) as caught:
        parse(text, "f.yaml")
    assert expected in str(caught.value)
    assert len(str(caught.value)) < 300
    assert "\x1b" not in str(caught.value)


TEXT = st.text(st.characters(exclude_categories=["Cs", "Cc"])) | st.sampled_from(
    [*CORE, *TEXTS, "a: b", "- a", "#", " a"]
)
SCALARS = st.none() | st.booleans() | st.integers(-(2**63), 2**63 - 1) | st.floats(allow_nan=False) | TEXT
KEYS = st.text(st.characters(categories=["L", "N", "P", "S", "Zs"]), max_size=8) | st.sampled_from([*CORE, *TEXTS])
TREES = st.recursive(
    SCALARS, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(KEYS, inner, max_size=4), max_leaves=12
)


@given(TREES)
def test_what_is_written_is_read(tree: Any) -> None:
    """Whatever plain values are written, they are read again: by us, and by a reader of YAML 1.1."""
    text = to_yaml({"a": tree})
    again = parse(text, "a.yaml").content["a"]
    assert repr(again) == repr(tree)
    assert repr(yaml.safe_load(text)["a"]) == repr(tree)


@given(TREES)
def test_plain_values_are_copies(tree: Any) -> None:
    """Equal to what was given, and made anew."""
    copied = plain_value(tree)
    assert repr(copied) == repr(tree)
    assert copied is not tree or not isinstance(tree, list | dict)


@pytest.mark.parametrize("value", [{1, 2}, b"x", 2**63, math.nan, {1: 2}, object(), "\x1b", "\ud800", {"a": [{1}]}])
def test_other_values_are_refused(value: Any) -> None:
    """What a file cannot hold, or a set whose order differs from process to process, is no option."""
    with pytest.raises(ValueError, match="expected"):
        plain_value(value)


def test_control_characters_are_made_visible() -> None:
    """Escape sequences, and what turns the direction of writing, never reach a terminal."""
    assert visible("a\x1b[31m\u202eb\nc\x85\ud800é") == "a\\x1b[31m\\u202eb\nc\\x85\\ud800é"
    assert "\x1b" not in str(SpecError("\x1b"))
