"""Which source a compiled function was made from: its module's, and that of all it imports from this package.

Numba freezes into machine code what a function takes from its module: the functions it calls, constants, the fields of
named tuples. All of these are written in that module or imported by it, so that a digest of both, directly or not, says
whether machine code is still that of today's source. Comments, docstrings and positions are not part of it: an edit of
these compiles nothing.
"""

from __future__ import annotations

import ast
import hashlib
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from uuid import uuid4


@dataclass(frozen=True)
class Module:
    """What one module says.

    Attributes
    ----------
    digest:
        Of its syntax tree without docstrings and positions.
    imports:
        Dotted names of what it imports from its package, be they modules or what modules hold, in order.
    """

    digest: str
    imports: tuple[str, ...]


@dataclass(frozen=True)
class Sources:
    """The modules of a package, as they were when they were read.

    Attributes
    ----------
    modules:
        By dotted names.
    paths, stamps:
        Their files, and these files' (time, size) just before they were read.
    """

    modules: Mapping[str, Module]
    paths: Mapping[str, Path]
    stamps: Mapping[str, tuple[int, int]]

    def needed(self, module: str) -> list[str]:
        """``module`` and all that it imports, directly or not, sorted."""
        found, coming = set[str](), [module]
        while coming:
            name = coming.pop()
            if name not in found:
                found.add(name)
                coming += [self._owner(imported) for imported in self.modules[name].imports]
        return sorted(found)

    def digest(self, modules: Sequence[str], *versions: str) -> str:
        """16 hexadecimal digits for the source of these modules, and for the ``versions`` of what compiles it."""
        parts = [*versions, *(f"{name} {self.modules[name].digest}" for name in modules)]
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]

    def is_current(self, modules: Sequence[str]) -> bool:
        """Whether the files of these modules still are those that were read."""
        with suppress(OSError):
            return all(_stamp(self.paths[name]) == self.stamps[name] for name in modules)
        return False

    def _owner(self, imported: str) -> str:
        """The module that an imported name is, or is defined in."""
        while imported not in self.modules:
            imported, _, _ = imported.rpartition(".")
        return imported


def read_sources(package: Path, memo: Path | None = None) -> Sources:
    """The modules of ``package``, the folder of a package that lies in no other.

    Parsing all of them takes a tenth of a second or two: ``memo`` is a file that remembers, by the bytes of each file,
    what came of it.
    """
    paths = {dotted(package, path): path for path in sorted(package.rglob("*.py"))}
    stamps = {name: _stamp(path) for name, path in paths.items()}
    contents = {name: path.read_bytes() for name, path in paths.items()}
    keys = {name: hashlib.sha256(f"{name} ".encode() + content).hexdigest() for name, content in contents.items()}
    known = _read_memo(memo)
    modules = {}
    for name, path in paths.items():
        modules[name] = known.get(keys[name]) or parse_module(contents[name], name, is_package=path.stem == "__init__")
    if any(key not in known for key in keys.values()):
        _write_memo(memo, {keys[name]: module for name, module in modules.items()})
    return Sources(modules, paths, stamps)


def parse_module(source: bytes, name: str, *, is_package: bool = False) -> Module:
    r"""What the module ``name`` says.

    >>> plain = b"from apel.run import state\ndef f(x): return x + state.RUNNING"
    >>> described = b"from apel.run import state  # 0\n\ndef f(x):\n    'Next.'\n    return x + state.RUNNING"
    >>> one, two = parse_module(plain, "apel.one"), parse_module(described, "apel.one")
    >>> one == two, one.imports
    (True, ('apel.run.state',))
    """
    try:
        tree = ast.parse(source)
    except SyntaxError:  # nobody can have imported it as it stands
        return Module(hashlib.sha256(source).hexdigest(), ())
    package = name.split(".")[0]
    imports = [one for one in _imports(tree, name, is_package=is_package) if one.split(".")[0] == package]
    _strip(tree)
    return Module(hashlib.sha256(ast.dump(tree).encode()).hexdigest(), tuple(imports))


def _imports(tree: ast.Module, name: str, *, is_package: bool) -> Iterator[str]:
    parts = name.split(".") if is_package else name.split(".")[:-1]
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = parts[: len(parts) - node.level + 1] if node.level else []
            yield from (".".join([*base, *filter(None, [node.module]), alias.name]) for alias in node.names)


def _strip(tree: ast.Module) -> None:
    """Remove all texts that stand alone: docstrings, and those that describe attributes."""
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            body[:] = [statement for statement in body if not _is_text(statement)]


def _is_text(statement: ast.stmt) -> bool:
    value = statement.value if isinstance(statement, ast.Expr) else None
    return isinstance(value, ast.Constant) and isinstance(value.value, str)


def dotted(package: Path, path: Path) -> str:
    """The name of the module in a file of ``package``."""
    parts = path.relative_to(package.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def _stamp(path: Path) -> tuple[int, int]:
    status = path.stat()
    return status.st_mtime_ns, status.st_size


def _maker() -> str:
    """What a digest depends on beside the source: Python's syntax tree, and what this file makes of it."""
    return f"{sys.version} {hashlib.sha256(Path(__file__).read_bytes()).hexdigest()}"


def _read_memo(memo: Path | None) -> dict[str, Module]:
    """What is remembered; nothing where that cannot be read, or was found out in another way."""
    with suppress(OSError, ValueError, KeyError, TypeError):
        content = json.loads(memo.read_text() if memo else "{}")
        if content["maker"] == _maker():
            return {key: Module(digest, tuple(imports)) for key, (digest, imports) in content["modules"].items()}
    return {}


def _write_memo(memo: Path | None, modules: Mapping[str, Module]) -> None:
    if memo is None:
        return
    content = {"maker": _maker(), "modules": {key: (one.digest, one.imports) for key, one in modules.items()}}
    written = memo.with_name(f"{memo.name}.{uuid4().hex}")
    with suppress(OSError):
        memo.parent.mkdir(parents=True, exist_ok=True)
        written.write_text(json.dumps(content))
        written.replace(memo)
