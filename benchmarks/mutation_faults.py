"""The faults that `mutation.py` plants: where a file can have one, and how it reads then."""

import ast
import copy
from dataclasses import dataclass


@dataclass(frozen=True)
class Fault:
    """One change of one file: the source between two offsets is replaced."""

    file: str
    lines: (
        range  # of the statement, or of its head: a test that executes one of them meets the fault
    )
    line: int
    kind: str
    before: str
    after: str
    start: int  # offset into the encoded file
    end: int
    on_import: bool

    def __str__(self):
        return f"{self.file}:{self.line} {self.kind}: {self.before} -> {self.after}"


SWAPPED = {
    ast.Add: ("sign", ast.Sub),
    ast.Sub: ("sign", ast.Add),
    ast.Mult: ("operator", ast.Div),
    ast.Div: ("operator", ast.Mult),
    ast.Pow: ("operator", ast.Mult),
    ast.FloorDiv: ("operator", ast.Mult),
    ast.Mod: ("operator", ast.FloorDiv),
    ast.BitAnd: ("operator", ast.BitOr),
    ast.BitOr: ("operator", ast.BitAnd),
    ast.And: ("operator", ast.Or),
    ast.Or: ("operator", ast.And),
}
COMPARED = {
    ast.Lt: (ast.LtE, ast.Gt),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.Lt),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
ABSOLUTE = {"abs", "fabs", "absolute"}
LIMITS = {"max", "min", "maximum", "minimum", "fmax", "fmin", "clip"}
TEXTS = (ast.JoinedStr, ast.List, ast.Tuple, ast.ListComp)


def faults_of(file: str, source: str):
    """Yield every place for a fault as a list of its variants."""
    starts = [0]
    for line in source.encode().splitlines(keepends=True):
        starts.append(starts[-1] + len(line))

    def visit(node, statement, inside, returns):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
            defaults = (
                []
                if isinstance(node, ast.ClassDef)
                else [*node.args.defaults, *node.args.kw_defaults]
            )
            for default in filter(None, defaults):
                yield from visit(default, node, inside, returns)
            function = not isinstance(node, ast.ClassDef)
            result = ast.unparse(node.returns) if function and node.returns else ""
            for child in node.body:
                yield from visit(child, child, inside or function, result)
            return
        if isinstance(node, ast.stmt):
            statement = node
        variants = list(changes(node, file, returns))
        if variants:
            head = getattr(statement, "body", None)
            last = head[0].lineno - 1 if isinstance(head, list) else statement.end_lineno
            place = (
                starts[node.lineno - 1] + node.col_offset,
                starts[node.end_lineno - 1] + node.end_col_offset,
            )
            lines = range(statement.lineno, max(last, statement.lineno) + 1)
            before = ast.unparse(node)
            yield [
                Fault(file, lines, node.lineno, kind, before, after, *place, not inside)
                for kind, after in variants
            ]
        for child in children(node):
            yield from visit(child, statement, inside, returns)

    yield from visit(ast.parse(source), None, False, "")


def children(node):
    """Yield the parts in which faults are planted."""
    if isinstance(node, (ast.JoinedStr, ast.Raise, ast.Import, ast.ImportFrom)):
        return
    if isinstance(node, ast.Call):
        name = called(node)
        if name in (
            "warn",
            "isinstance",
            "issubclass",
            "cast",
            "TypeVar",
            "ValueError",
            "OSError",
            "lru_cache",
        ):
            return
        yield node.func
        yield from node.args
        yield from (
            k.value for k in node.keywords if k.arg != "strict"
        )  # zip(strict=) is a check only
        return
    if isinstance(node, ast.AnnAssign):
        yield from filter(None, [node.value])
        return
    if isinstance(node, ast.Assign) and any(
        getattr(t, "id", "") == "__all__" for t in node.targets
    ):
        return
    if (
        isinstance(node, ast.UnaryOp)
        and isinstance(node.op, ast.USub)
        and isinstance(node.operand, ast.Constant)
    ):
        return
    yield from ast.iter_child_nodes(node)


def called(node) -> str:
    """Return the last name of what is called."""
    return getattr(node.func, "attr", getattr(node.func, "id", ""))


def is_text(node) -> bool:
    """Return whether an operand is a text or a list, of which + and * are no arithmetic."""
    return isinstance(node, TEXTS) or (
        isinstance(node, ast.Constant) and isinstance(node.value, str)
    )


def changes(node, file, returns):
    """Yield the faults that one node can have, as kind and new source."""
    if isinstance(node, (ast.BinOp, ast.AugAssign, ast.BoolOp)):
        yield from other_operator(node)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, (ast.USub, ast.Not)):
        yield (
            "sign" if isinstance(node.op, ast.USub) else "operator",
            f"({ast.unparse(node.operand)})",
        )
    elif isinstance(node, ast.Compare):
        for i, op in enumerate(node.ops):
            for other in COMPARED[type(op)]:
                yield "comparison", changed(node, ops=[*node.ops[:i], other(), *node.ops[i + 1 :]])
    elif isinstance(node, ast.Constant):
        if isinstance(node.value, (bool, int, float)) and not file.startswith(
            "greybox/reporting/plotting/"
        ):
            yield "constant", repr(another(node.value))
    elif isinstance(node, ast.Call):
        yield from without_limit(node)
    else:
        yield from removals(node, returns)


def changed(node, **parts) -> str:
    """Return the source of a node with other parts."""
    other = copy.copy(node)
    for name, value in parts.items():
        setattr(other, name, value)
    return f"({ast.unparse(other)})" if isinstance(other, ast.expr) else ast.unparse(other)


def other_operator(node):
    """Yield an operation with its opposite in its place; of texts and lists it is no arithmetic."""
    operands = {ast.BinOp: ("left", "right"), ast.AugAssign: ("value",), ast.BoolOp: ()}[type(node)]
    if type(node.op) in SWAPPED and not any(is_text(getattr(node, name)) for name in operands):
        kind, other = SWAPPED[type(node.op)]
        yield kind, changed(node, op=other())


def without_limit(node):
    """Yield what an absolute value or a limit is taken of."""
    if called(node) in ABSOLUTE and len(node.args) == 1:
        yield "abs", f"({ast.unparse(node.args[0])})"
    elif called(node) in LIMITS and len(node.args) >= 2:
        kept = next(
            (a for a in node.args if not isinstance(a, (ast.Constant, ast.UnaryOp, ast.Starred))),
            None,
        )
        if kept is not None:
            yield "limit", f"({ast.unparse(kept)})"


def removals(node, returns):
    """Yield a statement that no longer says what is wrong."""
    if isinstance(node, ast.Raise) and "NotImplemented" not in ast.unparse(node):
        yield "removal", "pass"
    elif (
        isinstance(node, ast.Return)
        and node.value is not None
        and "str" in returns
        and "None" in returns
    ):
        if isinstance(node.value, ast.JoinedStr) or is_text(node.value):
            yield "removal", "return None"
    elif isinstance(node, ast.Expr):
        value = node.value
        if isinstance(value, ast.Yield) and isinstance(value.value, ast.JoinedStr):
            yield "removal", "yield from ()"
        elif isinstance(value, ast.Call):
            says = any(isinstance(a, ast.JoinedStr) for a in value.args)
            if called(value) == "warn" or (called(value) in ("append", "add") and says):
                yield "removal", "pass"


def another(number):
    """Return a number as a slip would leave it.

    One off, twice as large, or a tolerance with another exponent.
    """
    if isinstance(number, bool):
        return not number
    if isinstance(number, int):
        return number + 1 if number < 1000 else 2 * number
    if number == 0:
        return 1.0
    return number * (1000 if abs(number) < 1e-5 else 2)
