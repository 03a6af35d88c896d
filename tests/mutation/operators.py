"""The ways in which a line is broken: small slips that a person could make, each as an edit of the syntax tree."""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator
from dataclasses import dataclass

Change = Callable[[], None]
"""Breaks the tree that it was found in, in place."""

COMPARISONS: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Is: ast.IsNot, ast.IsNot: ast.Is,
}  # fmt: skip
ARITHMETIC: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult, ast.Mod: ast.Add,
    ast.Pow: ast.Mult, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd,
}  # fmt: skip
EXTREMES = {
    "min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum", "argmin": "argmax", "argmax": "argmin",
}  # fmt: skip


@dataclass(frozen=True)
class Mutant:
    """One broken line.

    Attributes
    ----------
    path, line:
        Of the original.
    kind:
        What was done.
    before, after:
        The statement, or the head of it.
    source:
        The whole broken file.
    """

    path: str
    line: int
    kind: str
    before: str
    after: str
    source: str


def mutants(path: str, source: str) -> list[Mutant]:
    """All mutants of a file, in the order of its syntax tree; of two ways to the same one, the first."""
    found: dict[str, Mutant] = {}
    for index, (kind, _, _) in enumerate(_changes(ast.parse(source))):
        tree = ast.parse(source)
        _, statement, change = list(_changes(tree))[index]
        before, line = _head(statement), statement.lineno
        change()
        broken = ast.unparse(ast.fix_missing_locations(tree))
        found.setdefault(broken, Mutant(path, line, kind, before, _head(statement), broken))
    return [mutant for mutant in found.values() if mutant.before != mutant.after]


def _head(statement: ast.stmt) -> str:
    return ast.unparse(statement).split("\n")[0]


def _changes(tree: ast.Module) -> Iterator[tuple[str, ast.stmt, Change]]:
    """What kind, in which statement, and how; nothing in annotations, decorators and what is raised."""
    for statement in _statements(tree.body):
        yield from ((kind, statement, change) for kind, change in _of_statement(statement))
        for node in _expressions(statement):
            yield from ((kind, statement, change) for kind, change in _of_expression(node))


def _statements(body: list[ast.stmt]) -> Iterator[ast.stmt]:
    for statement in body:
        if not isinstance(statement, ast.Import | ast.ImportFrom | ast.Raise | ast.Global | ast.Nonlocal):
            yield statement
        for inner in ("body", "orelse", "finalbody"):
            yield from _statements(getattr(statement, inner, []))
        for handler in getattr(statement, "handlers", []):
            yield from _statements(handler.body)


def _expressions(statement: ast.stmt) -> Iterator[ast.expr]:
    """The expressions of a statement's own line, without those of the statements within it."""
    for name, value in ast.iter_fields(statement):
        if name in ("annotation", "returns", "decorator_list", "bases", "keywords"):
            continue
        values = value if isinstance(value, list) else [value]
        if isinstance(value, ast.arguments):
            values = [*value.defaults, *filter(None, value.kw_defaults)]
        for one in values:
            root = one.context_expr if isinstance(one, ast.withitem) else one
            if isinstance(root, ast.expr):
                yield from (node for node in ast.walk(root) if isinstance(node, ast.expr))


def _of_statement(statement: ast.stmt) -> Iterator[tuple[str, Change]]:
    match statement:
        case ast.Expr(value=ast.Call()):
            yield "call removed", lambda: setattr(statement, "value", ast.Constant(value=None))
        case ast.AugAssign(op=op):
            if type(op) in ARITHMETIC:
                yield "arithmetic", lambda: setattr(statement, "op", ARITHMETIC[type(op)]())
            yield "assignment removed", lambda: setattr(statement, "value", _neutral(op))
        case ast.Assign(targets=[ast.Subscript() | ast.Attribute() as target]):
            yield "assignment removed", lambda: setattr(statement, "value", _loaded(target))
        case ast.If(test=test) | ast.While(test=test):
            yield "condition negated", lambda: setattr(statement, "test", ast.UnaryOp(op=ast.Not(), operand=test))


def _neutral(op: ast.operator) -> ast.expr:
    """What leaves a number as it is."""
    return ast.Constant(value=1 if isinstance(op, ast.Mult | ast.Div | ast.Pow) else 0)


def _loaded(target: ast.expr) -> ast.expr:
    """The value of what a statement assigns to."""
    return ast.parse(ast.unparse(target), mode="eval").body


def _of_expression(node: ast.expr) -> Iterator[tuple[str, Change]]:
    match node:
        case ast.Compare(ops=[op]):
            yield "comparison", lambda: setattr(node, "ops", [COMPARISONS[type(op)]()])
        case ast.BinOp(op=op) if type(op) in ARITHMETIC and not isinstance(node.left, ast.JoinedStr):
            yield "arithmetic", lambda: setattr(node, "op", ARITHMETIC[type(op)]())
        case ast.BoolOp(op=op):
            yield "and ↔ or", lambda: setattr(node, "op", ast.Or() if isinstance(op, ast.And) else ast.And())
        case ast.IfExp(test=test):
            yield "condition negated", lambda: setattr(node, "test", ast.UnaryOp(op=ast.Not(), operand=test))
        case ast.Constant(value=bool(value)):
            yield "constant", lambda: setattr(node, "value", not value)
        case ast.Constant(value=int(value) | float(value)):
            yield "constant + 1", lambda: setattr(node, "value", value + 1)
            yield "constant − 1", lambda: setattr(node, "value", value - 1)
        case ast.Call(func=ast.Name(id=name)) if name in EXTREMES:
            yield "min ↔ max", lambda: setattr(node.func, "id", EXTREMES[name])
        case ast.Call(func=ast.Attribute(attr=name)) if name in EXTREMES:
            yield "min ↔ max", lambda: setattr(node.func, "attr", EXTREMES[name])
