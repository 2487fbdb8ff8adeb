"""All mutants of one source: each has a single small mistake of the kind that people make.

Comparison, boolean and arithmetic operators, constants, conditions, returned values, left-out statements and arguments
that change places. Types, texts and what the compiler is told (`@njit(...)`) are left alone: tests run as plain Python.
"""

import ast
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import CodeType

COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE), ast.LtE: (ast.Lt, ast.Gt), ast.Gt: (ast.GtE, ast.LtE), ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq, ast.LtE, ast.GtE), ast.NotEq: (ast.Eq,), ast.In: (ast.NotIn,), ast.NotIn: (ast.In,),
    ast.Is: (ast.IsNot,), ast.IsNot: (ast.Is,),
}  # fmt: skip
OPERATORS: dict[type[ast.operator], tuple[type[ast.operator], ...]] = {
    ast.Add: (ast.Sub,), ast.Sub: (ast.Add,), ast.Mult: (ast.Div,), ast.Div: (ast.Mult,), ast.Mod: (ast.FloorDiv,),
    ast.FloorDiv: (ast.Mod,), ast.BitAnd: (ast.BitOr,), ast.BitOr: (ast.BitAnd,), ast.BitXor: (ast.BitOr,),
    ast.LShift: (ast.RShift,), ast.RShift: (ast.LShift,),
}  # fmt: skip
CALLS = {"min": "max", "max": "min", "all": "any", "any": "all"}


@dataclass(frozen=True)
class Mutant:
    """`code` is a whole module that differs from the original in what `what` says."""

    line: int
    what: str
    code: CodeType

    def __str__(self) -> str:
        return f"line {self.line}: {self.what}"


def mutants(source: str) -> list[Mutant]:
    """Every mutant of the module `source`, in the order of its lines."""
    tree = ast.parse(source)
    compiler = {id(part) for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)
                for decorator in node.decorator_list for part in ast.walk(decorator)}  # fmt: skip
    found = []
    for node in [node for node in ast.walk(tree) if id(node) not in compiler]:
        for what, field, value in _edits(node):
            with _edited(node, field, value):
                code = compile(ast.fix_missing_locations(tree), "<mutant>", "exec")
            found.append(Mutant(getattr(node, "lineno", 0), what, code))
    return sorted(found, key=lambda mutant: mutant.line)


@contextmanager
def _edited(node: ast.AST, field: str | tuple[str, int], value: object) -> Iterator[None]:
    """`node` with another value in a field, or in one place of a field that is a list."""
    if isinstance(field, tuple):
        values = getattr(node, field[0])
        former, values[field[1]] = values[field[1]], value
        yield
        values[field[1]] = former
    else:
        former = getattr(node, field)
        setattr(node, field, value)
        yield
        setattr(node, field, former)


Edit = tuple[str, str | tuple[str, int], object]


def _edits(node: ast.AST) -> list[Edit]:
    """(words, field or (field, position), new value) of every edit of one node."""
    edits: list[Edit] = []
    if isinstance(node, ast.Compare):
        for k, old in enumerate(node.ops):
            edits += [(f"{ast.unparse(node)}: {_name(old)} -> {new.__name__}", ("ops", k), new())
                      for new in COMPARISONS[type(old)]]  # fmt: skip
    elif isinstance(node, ast.BinOp | ast.AugAssign):
        edits += [(f"{ast.unparse(node)}: {_name(node.op)} -> {new.__name__}", "op", new())
                  for new in OPERATORS.get(type(node.op), ())]  # fmt: skip
    elif isinstance(node, ast.BoolOp):
        new = ast.Or if isinstance(node.op, ast.And) else ast.And
        edits.append((f"{ast.unparse(node)}: {_name(node.op)} -> {new.__name__}", "op", new()))
        for value in node.values:
            rest = [v for v in node.values if v is not value]
            twice = [*rest, rest[0]]  # an operator wants two sides; the same one twice changes nothing
            edits.append((f"{ast.unparse(node)}: without {ast.unparse(value)}", "values", twice))
    elif isinstance(node, ast.If | ast.IfExp | ast.While):
        words = f"if {ast.unparse(node.test)}"
        edits += [(f"{words}: always {to}", "test", ast.Constant(to)) for to in (True, False)]
        edits.append((f"{words}: negated", "test", ast.UnaryOp(ast.Not(), node.test)))
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.USub | ast.Invert):
        edits.append((f"{ast.unparse(node)}: without {_name(node.op)}", "op", ast.UAdd()))
    elif isinstance(node, ast.Constant):
        edits += [(f"{node.value!r} -> {new!r}", "value", new) for new in _other_constants(node.value)]
    elif isinstance(node, ast.Return) and node.value is not None and not isinstance(node.value, ast.Constant):
        edits.append((f"return {ast.unparse(node.value)}: nothing", "value", ast.Constant(None)))
    elif isinstance(node, ast.Call):
        edits += _call_edits(node)
    if hasattr(node, "body") and isinstance(node.body, list):
        edits += _left_out(node, "body")
        if getattr(node, "orelse", None):
            edits += _left_out(node, "orelse")
    return edits


def _other_constants(value: object) -> tuple[object, ...]:
    if isinstance(value, bool):
        return (not value,)
    if isinstance(value, int | float):
        return (value + 1, value - 1)
    return ()


def _call_edits(node: ast.Call) -> list[Edit]:
    edits: list[Edit] = []
    if isinstance(node.func, ast.Name) and node.func.id in CALLS:
        edits.append((f"{ast.unparse(node)}: {CALLS[node.func.id]}", "func", ast.Name(CALLS[node.func.id], ast.Load())))
    for k in range(len(node.args) - 1):
        swapped = [*node.args[:k], node.args[k + 1], node.args[k], *node.args[k + 2 :]]
        commutes = isinstance(node.func, ast.Name) and node.func.id in CALLS
        if not commutes and not any(isinstance(a, ast.Starred) for a in node.args):
            edits.append((f"{ast.unparse(node)}: arguments {k} and {k + 1} swapped", "args", swapped))
    return edits


def _left_out(node: ast.AST, field: str) -> list[Edit]:
    """Each statement of a block replaced by nothing. Definitions, imports and texts stay."""
    stays = (ast.FunctionDef, ast.ClassDef, ast.Import, ast.ImportFrom, ast.Pass, ast.Return, ast.Raise)
    edits: list[Edit] = []
    for k, statement in enumerate(getattr(node, field)):
        text = isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)
        declared = isinstance(statement, ast.AnnAssign) and statement.value is None
        if not isinstance(statement, stays) and not text and not declared and not isinstance(node, ast.Module):
            first = ast.unparse(statement).splitlines()[0]
            edits.append((f"without: {first}", (field, k), ast.Pass()))
    return edits


def _name(operator: ast.AST) -> str:
    return type(operator).__name__
