"""Every command of the guide is run, page by page, and prints what the page says that it prints.

A page is a session in one shell and one folder, in order. A ``python`` or ``yaml`` block is a file, whose name is the
comment in its first line. Of an ``sh`` block the lines that begin with ``$`` are typed, and the lines after each are
expected, standard error included: `…` stands for anything within a line, and alone on a line for any number of lines.
Blank lines and the width of gaps do not count. A command fails, by its exit code, if and only if it prints a line that
begins with ``error:``.
"""

from __future__ import annotations

import os
import re
import subprocess
import tempfile
import threading
import urllib.request
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import psutil
import pytest
from moto.server import ThreadedMotoServer

from tests.forks import BIN
from tests.ray_head import free_ports
from tests.same_rows import assert_same, play
from tests.standing_by import standing_by

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
GUIDE = DOCS / "guide"
PAGES = sorted(GUIDE.glob("[0-9]*.md"))
ON_RAY = {"4-on-a-cluster", "6-troubleshooting"}
_MARK = "@@ the command above ended with"
_PROGRAMS = ("apel", "ray", "python")
_PAGE_SECONDS = 800.0  # none takes a tenth of it by itself: a guard against standing still, not a measure of speed

BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", flags=re.DOTALL | re.MULTILINE)
FILE_NAME = re.compile(r"# ([\w.-]+\.(?:py|yaml))$")
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")


@dataclass
class Command:
    """A line that is typed, and the lines that it should print."""

    text: str
    expected: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class File:
    """A file that a page shows."""

    name: str
    content: str


def blocks(page: Path) -> list[tuple[str, str]]:
    """Language and text of each block."""
    return [(match[1], match[2]) for match in BLOCK.finditer(page.read_text())]


def steps(page: Path) -> Iterator[File | Command]:
    """What a page has one write and type, in order."""
    for language, text in blocks(page):
        if language != "sh":
            name = FILE_NAME.match(text.splitlines()[0])
            assert name, f"{page.name}: found a block of {language} without a file name: {text[:60]!r}"
            yield File(name[1], text)
            continue
        yield from commands(text)


def commands(block: str) -> Iterator[Command]:
    """The commands of an ``sh`` block; one that ends with a backslash goes on in the next line."""
    command: Command | None = None
    for line in block.splitlines():
        if line.startswith("$ "):
            if command:
                yield command
            command = Command(line.removeprefix("$ "))
        elif command and command.text.endswith("\\") and not command.expected:
            command.text += f"\n{line}"
        else:
            assert command, f"found output before any command: {line!r}"
            command.expected.append(line)
    if command:
        yield command


def plain(text: str) -> list[str]:
    """The lines of an output without what does not count."""
    text = re.sub(r"\x1b\[[0-9;]*m", "", text)
    lines = (re.sub(r"─+", "─", re.sub(r"\s+", " ", line)).strip() for line in text.splitlines())
    return [line for line in lines if line]


def agrees(expected: list[str], printed: list[str]) -> bool:
    """Whether an output is the expected one."""
    pattern = "".join(
        r"(?:.*\n)*?" if line == "…" else ".*".join(map(re.escape, line.split("…"))) + r"\n"
        for line in plain("\n".join(expected))
    )
    return re.fullmatch(pattern, "".join(f"{line}\n" for line in printed)) is not None


class Shell:
    """A shell that is told one command after the other."""

    def __init__(self, folder: Path, env: Mapping[str, str], replaced: Mapping[str, str]) -> None:
        self._folder, self._replaced = folder, replaced
        self.expired = False
        self._process = subprocess.Popen(
            ["bash", "--noprofile", "--norc"], cwd=folder, env=dict(env), text=True, start_new_session=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        )  # fmt: skip

    def call(self, command: str) -> tuple[int, list[str]]:
        """Exit code and output of a command, with the names that the page uses."""
        assert self._process.stdin
        assert self._process.stdout
        for name, real in self._replaced.items():
            command = command.replace(name, real)
        self._process.stdin.write(f"{command}\nprintf '\\n{_MARK} %d\\n' $?\n")
        self._process.stdin.flush()
        printed = []
        for line in self._process.stdout:
            if line.startswith(_MARK):
                return int(line.split()[-1]), plain(self._as_on_the_page("".join(printed)))
            printed.append(line)
        raise AssertionError(f"the shell ended in {command!r} after printing {''.join(printed)!r}")

    def expire(self) -> None:
        """End it since it took too long."""
        self.expired = True
        self.end()

    def end(self) -> None:
        """End it and whatever it has started that is still there."""
        with suppress(psutil.NoSuchProcess):
            shell = psutil.Process(self._process.pid)
            started, family = shell.children(), shell.children(recursive=True)
            for process in started:
                with suppress(psutil.NoSuchProcess):
                    process.terminate()
            psutil.wait_procs(started, timeout=3)
            for process in [shell, *family]:
                with suppress(psutil.NoSuchProcess):
                    process.kill()
        self._process.communicate()

    def _as_on_the_page(self, text: str) -> str:
        for name, real in self._replaced.items():
            text = text.replace(real, name)
        return text


@contextmanager
def shell(folder: Path, env: Mapping[str, str], replaced: Mapping[str, str]) -> Iterator[Shell]:
    """A shell that does not outlast the time for a page."""
    session = Shell(folder, env, replaced)
    watch = threading.Timer(_PAGE_SECONDS, session.expire)
    watch.start()
    try:
        yield session
    finally:
        watch.cancel()
        session.end()


@pytest.fixture(scope="module")
def storage_port() -> Iterator[int]:
    """The port of a server that speaks S3, with a bucket called ``lab``."""
    (port,) = free_ports(1)
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=port, verbose=False)
    server.start()
    with urllib.request.urlopen(urllib.request.Request(f"http://127.0.0.1:{port}/lab", method="PUT"), timeout=10):
        pass
    yield port
    server.stop()


@pytest.fixture(scope="module")
def programs() -> Iterator[str]:
    """A folder with ``apel``."""
    with standing_by() as folder:
        yield folder


def surroundings(folder: Path, programs: str) -> dict[str, str]:
    """The environment of a user who has installed the program, and set nothing."""
    ours = {name: value for name, value in os.environ.items() if not name.startswith(("RAY_", "APEL_", "AWS_"))}
    return {
        **ours,
        "PATH": os.pathsep.join((programs, str(BIN), os.environ["PATH"])),
        "XDG_STATE_HOME": str(folder / "state"),
        "PYTHONUNBUFFERED": "1",  # standard output and error in the order in which a terminal shows them
        "RAY_USAGE_STATS_ENABLED": "0",
        "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
        "RAY_worker_niceness": "0",  # or they wait for other tests
        "AWS_EC2_METADATA_DISABLED": "true",
    }


def ports_of(page: str, storage_port: int, temporary: Path) -> dict[str, str]:
    """What stands on the pages → what stands for it here: free ports, and nodes that leave others' alone."""
    if page not in ON_RAY:
        return {}
    gcs, dashboard, *ports = map(str, free_ports(7))
    head = f"--temp-dir={temporary} --dashboard-agent-listen-port={ports[0]} --metrics-export-port={ports[1]}"
    head += f" --ray-client-server-port={ports[2]} --object-store-memory=150000000"
    node = f"--dashboard-agent-listen-port={ports[3]} --metrics-export-port={ports[4]} --object-store-memory=100000000"
    return {
        "ray start --head": f"ray start {head} --head",
        "ray start --address": f"ray start {node} --address",
        "6379": gcs,
        "8265": dashboard,
        "127.0.0.1:9000": f"127.0.0.1:{storage_port}",
    }


def follow(page: Path, storage_port: int, programs: str) -> str:
    """Do what a page says; returns the first thing that turned out otherwise, empty if there is none."""
    # Not below pytest's own folder: Ray's sockets lie in it, and their paths may not be long.
    with tempfile.TemporaryDirectory(prefix="apel-guide-", ignore_cleanup_errors=True) as temporary:
        folder = Path(temporary, "here")
        folder.mkdir()
        replaced = ports_of(page.stem, storage_port, Path(temporary, "ray"))
        env = surroundings(Path(temporary), programs)
        if page.stem in ON_RAY:  # where the page expects nobody, there may be a Ray of another test's
            env["RAY_API_SERVER_ADDRESS"] = f"http://127.0.0.1:{replaced['8265']}"
        with shell(folder, env, replaced) as session:
            for step in steps(page):
                if isinstance(step, File):
                    (folder / step.name).write_text(step.content)
                elif wrong := deviation(step, session):
                    logs = [f"{log.name}:\n{log.read_text()[-2000:]}" for log in sorted(folder.glob("*.log"))]
                    return "\n".join([f"{page.name}: {wrong}", *logs])
            if page.stem == "4-on-a-cluster":
                check_rows(folder)
    return ""


def check_rows(folder: Path) -> None:
    """The job that was stopped, and lost its head, has the rows of one that was played here at once."""
    (fetched,) = (folder / "here" / "long").iterdir()
    assert_same(play(folder / "long.yaml", folder / "at-once", placement="local"), fetched)


def deviation(command: Command, session: Shell) -> str:
    """What a command does otherwise than its page says; empty if nothing."""
    code, printed = session.call(command.text)
    assert not session.expired, f"found no end within {_PAGE_SECONDS:.0f} s: {command.text!r} printed {printed}"
    fails = any(line.startswith("error:") for line in printed)
    if agrees(command.expected, printed) and fails == (code != 0):
        return ""
    return "\n".join([f"{command.text!r} ended with {code} and printed", *printed])


@pytest.mark.timeout(2 * _PAGE_SECONDS)
@pytest.mark.parametrize(
    "page", [pytest.param(page, id=page.stem, marks=[pytest.mark.ray] * (page.stem in ON_RAY)) for page in PAGES]
)
def test_page(page: Path, storage_port: int, programs: str) -> None:
    """A page can be followed to the letter."""
    wrong = follow(page, storage_port, programs)
    assert not wrong, wrong


def test_every_command_stands_in_a_block() -> None:
    """No page tells one to type what is not run: blocks are sessions or files, and prose only names what they use."""
    typed = {" ".join(words[:2]) for words in map(str.split, all_typed())}
    for page in [*PAGES, GUIDE / "README.md"]:
        for language, _ in blocks(page):
            assert language in ("sh", "python", "yaml"), f"{page.name}: found a block of {language!r}"
        prose = BLOCK.sub("", page.read_text())
        for span in re.findall(r"`([^`\n]+)`", prose):
            words = span.split()
            if words[0] in _PROGRAMS and len(words) > 1:
                assert " ".join(words) in typed, f"{page.name}: `{span}` is run in no block"
        for line in prose.splitlines():
            assert not re.match(rf"\s*\$ |\s{{4,}}({'|'.join(_PROGRAMS)}) ", line), f"{page.name}: {line}"


def all_typed() -> Iterator[str]:
    """All commands of all pages, from the name of a program on."""
    for page in PAGES:
        for step in steps(page):
            if isinstance(step, Command):
                for match in re.finditer(rf"\b({'|'.join(_PROGRAMS)}) [^\n|;&]+", step.text):
                    yield match[0]


def test_every_command_of_the_program_is_in_the_guide() -> None:
    """Whoever has read the guide has met the commands that deal with experiments, jobs and results."""
    met = {words[1] for words in map(str.split, all_typed()) if words[0] == "apel"}
    assert met >= {
        "claims", "compare", "design", "evaluate", "export", "fetch", "figures", "jobs", "list", "logs", "resume",
        "run", "show", "status", "stop", "submit", "validate",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("expected", "printed", "same"),
    [
        (["a  b", "", "…", "d"], "a b\nc\nc\nd", True),
        (["… runs in … s"], "12 runs in 0.3 s", True),
        (["12 runs in … s"], "13 runs in 0.3 s", False),
        (["a"], "a\nb", False),
        (["a", "b"], "a", False),
        ([" ──── "], "\x1b[1m ──────── \x1b[0m", True),
    ],
)
def test_agreement(*, expected: list[str], printed: str, same: bool) -> None:
    """A page that says something else than what is printed is wrong."""
    assert agrees(expected, plain(printed)) is same


def test_parsing() -> None:
    """Commands, their continuation lines and their output are told apart."""
    found = list(commands("$ one \\\n    --two\nsaid\n$ three\n"))
    assert found == [Command("one \\\n    --two", ["said"]), Command("three")]


@pytest.mark.parametrize("page", [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))], ids=lambda page: page.name)
def test_links(page: Path) -> None:
    """Links within the documentation lead somewhere."""
    prose = BLOCK.sub("", page.read_text())
    for target in LINK.findall(prose):
        if re.match(r"[a-z]+:", target):
            continue
        path, _, anchor = target.partition("#")
        file = (page.parent / path).resolve() if path else page
        assert file.exists(), f"{page.name}: {target}"
        if anchor:
            headings = re.findall(r"^#+ (.*)$", file.read_text(), flags=re.MULTILINE)
            assert anchor in {_slug(heading) for heading in headings}, f"{page.name}: {target}"


def _slug(heading: str) -> str:
    """The anchor of a heading."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-")
