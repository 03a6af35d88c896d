"""What others have chosen is shown as text: neither a terminal nor rich takes it for a command."""

from __future__ import annotations

import io
import json

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.progress import Progress, TextColumn
from rich.table import Table
from rich.text import Text

from jobs.analysis.pages.escaping import markdown_cell, printable, printable_log
from jobs.cli.consoles import TextConsole

HOSTILE = ["[/a]", "[/red]", "[red]x[/red]", ":smile:", "[link=http://x]y[/link]", "\\[", "[", "]["]
COMMANDS = ["\x1b[2J", "\x1b]0;title\x07", "\x9b31m", "\r", "\x08", "\x7f", "\u202e", "\ud800"]


def shown(what: object, **options: object) -> str:
    """What a console writes."""
    file = io.StringIO()
    TextConsole(file=file, width=200).print(what, **options)  # type: ignore[arg-type]
    return file.getvalue()


def table_of(text: str) -> Table:
    """A table with a text in its title, a heading and a cell."""
    table = Table(text, title=text)
    table.add_row(text)
    return table


@pytest.mark.parametrize("text", HOSTILE)
def test_markup_is_text(text: str) -> None:
    """What looks like markup or an emoji is shown as it is, alone and in a table."""
    assert shown(text) == f"{text}\n"
    assert shown(table_of(text)).count(text) == 3


@pytest.mark.parametrize("text", COMMANDS)
def test_no_command_reaches_the_terminal(text: str) -> None:
    """Control characters are spelled out, in strings, tables, texts and bars."""
    bar = Progress(TextColumn("{task.description}", markup=False))
    bar.add_task(text)
    for what in (text, table_of(text)):
        assert printable(text) in shown(what)
    for what in (text, table_of(text), Text(text), bar.get_renderable()):
        assert text not in shown(what)


def test_columns_stay_in_line() -> None:
    """A name is as wide as it is shown."""
    lines = shown(table_of("\x1b[2J")).splitlines()
    assert len({len(line) for line in lines[1:]}) == 1


def test_json_stays_json() -> None:
    """`status --json` is for programs: it can be read again, whatever it holds."""
    file = io.StringIO()
    content = {"job": "".join(COMMANDS[:-1]) + "ü"}
    TextConsole(file=file).print_json(json.dumps(content), ensure_ascii=True)
    assert file.getvalue().isascii()
    assert json.loads(file.getvalue()) == content


@given(st.text())
def test_printable(text: str) -> None:
    """Whatever the text, nothing is left that a terminal obeys, and nothing else is lost."""
    made = printable(text)
    assert all(character.isprintable() or character in "\n\t" or ord(character) > 0x9F for character in made)
    assert printable(made) == made


@given(st.text(alphabet="\x1b[0m;31\r\nJa"))
def test_log_keeps_colours_alone(text: str) -> None:
    """Of what a job has printed, only colours are left."""
    rest = printable_log(text)
    for colour in ("\x1b[0m", "\x1b[31m", "\x1b[0;31m", "\x1b[m"):
        assert (colour in text) == (colour in rest)
    assert "\r" not in rest
    assert "\x1b[J" not in rest


def test_markdown_cell() -> None:
    """A cell of the ledger stays one cell, without tags and links; numbers and comparisons stay as they are."""
    assert markdown_cell("< 500") == "< 500"
    assert markdown_cell("<img src=x>") == "&lt;img src=x>"
    assert markdown_cell("a\nb|c") == "a b\\|c"
    assert markdown_cell("[x](javascript:y)") == "[x\\](javascript:y)"
