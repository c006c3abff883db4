"""Mutations: small faults in a Python file, one at a time.

``mutations(text)`` lists them: another operator, another number, another comparison, a dropped term
or factor, a condition turned round, a check or a statement removed.  ``mutation.apply(text)`` is
the file with the fault; nothing else in it changes, no line moves.  Code that no number depends on
is not changed: docstrings, annotations, decorators, texts and messages, ``__repr__``, raised
errors, printed and reported values, blocks for type checkers, styles of pictures, and decimal
numbers below 1e-4 or above 1e6, which are tolerances.
"""

import ast
import hashlib
from collections import Counter
from dataclasses import dataclass

OTHER = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.FloorDiv,
    ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
}
COMPARED = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
FUNCTIONS = {
    "max": "min",
    "min": "max",
    "maximum": "minimum",
    "minimum": "maximum",
    "any": "all",
    "all": "any",
    "sin": "cos",
    "cos": "sin",
    "argmax": "argmin",
    "argmin": "argmax",
}
TERMS = (ast.Add, ast.Sub, ast.Mult, ast.Div)
TOLERANCE = 1e-4
TEXTS = {"__repr__", "__str__", "_repr_html_", "_repr_mimebundle_", "__rich_repr__"}
SPEAKERS = {
    "print",
    "warn",
    "progress",
    "debug",
    "info",
    "warning",
    "format",
    "add_argument",
    "add_parser",
    "set_title",
    "set_xlabel",
    "set_ylabel",
    "legend",
    "text",
    "annotate",
    "tick_params",
    "tight_layout",
}
MANNERS = {"compare", "init", "kw_only", "repr", "strict"}
LOOKS = {
    "alpha",
    "aspect",
    "bbox_to_anchor",
    "capsize",
    "color",
    "dpi",
    "edgecolor",
    "figsize",
    "fontsize",
    "fraction",
    "frameon",
    "labelpad",
    "labelsize",
    "linestyle",
    "linewidth",
    "linewidths",
    "lw",
    "margin",
    "markersize",
    "ms",
    "pad",
    "rotation",
    "shrink",
    "width",
    "window_size",
    "zorder",
}
CHECKS = ("require", "check", "refuse", "need", "validate")


@dataclass(frozen=True)
class Mutation:
    """A fault: where it is, of which kind, and the texts before and after.

    ``function`` is the name of the function or class around it, '' for the module; ``number``
    counts mutations that agree in all of these.
    """

    function: str
    kind: str
    before: str
    after: str
    number: int
    start: tuple[int, int]
    end: tuple[int, int]

    @property
    def assigns(self):
        """Whether it changes an assignment such as ``a += b``."""
        return isinstance(ast.parse(self.before).body[0], ast.AugAssign)

    def apply(self, text):
        """The file with the fault."""
        lines = text.encode().splitlines(keepends=True)
        above = [len(line) for line in lines]
        start = sum(above[: self.start[0] - 1]) + self.start[1]
        end = sum(above[: self.end[0] - 1]) + self.end[1]
        whole = text.encode()
        kept = b"\n" * whole[start:end].count(b"\n")
        new = self.after.encode() + kept
        if not (self.after == "pass" or self.assigns):
            new = b"(" + new + b")"
        return (whole[:start] + new + whole[end:]).decode()

    def name(self, module):
        """A short name that lines which come or go elsewhere do not change."""
        parts = (module, self.function, self.kind, self.before, self.after, self.number)
        return hashlib.sha256(repr(parts).encode()).hexdigest()[:10]


def mutations(text):
    """All mutations of a file, in the order of its lines."""
    tree = ast.parse(text)
    found, count = [], Counter()
    for node, function in visited(tree, ""):
        for kind, old, new in changed(node):
            before, after = ast.unparse(old), ast.unparse(new)
            key = (function, kind, before, after)
            start = (old.lineno, old.col_offset)
            end = (old.end_lineno, old.end_col_offset)
            found.append(Mutation(*key, count[key], start, end))
            count[key] += 1
    return sorted(found, key=lambda m: (m.start, m.kind, m.after))


def visited(node, function):
    """The nodes of a tree that may change, with the names of the functions around them."""
    if left_alone(node):
        return
    if isinstance(node, ast.FunctionDef | ast.ClassDef):
        function = f"{function}.{node.name}".lstrip(".")
    yield node, function
    for field, value in ast.iter_fields(node):
        if field in ("annotation", "returns", "decorator_list", "bases"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST):
                yield from visited(child, function)


def left_alone(node):
    """Whether nothing inside of a node changes a number."""
    if isinstance(node, ast.Raise | ast.Assert | ast.JoinedStr | ast.Import):
        return True
    if isinstance(node, ast.FunctionDef):
        return node.name in TEXTS or overloaded(node)
    if isinstance(node, ast.If):
        return ast.unparse(node.test) in ("TYPE_CHECKING", "__name__ == '__main__'")
    if isinstance(node, ast.Call):
        return called(node) in SPEAKERS
    if isinstance(node, ast.keyword):
        return node.arg in LOOKS | MANNERS
    return isinstance(node, ast.Assign) and names_texts(node)


def overloaded(node):
    """Whether a function stands for type checkers alone, or has no body yet."""
    decorators = {ast.unparse(d) for d in node.decorator_list}
    return bool(decorators & {"overload", "abstractmethod"})


def called(node):
    """The last name of what is called."""
    function = node.func
    return getattr(function, "attr", getattr(function, "id", ""))


def names_texts(node):
    """Whether an assignment is one of ``__all__ = ...``."""
    return any(isinstance(t, ast.Name) and t.id.startswith("__") for t in node.targets)


def changed(node):
    """Triples (kind, part of the node, what stands in its place)."""
    if isinstance(node, ast.If | ast.While):
        return [decision(node)]
    rule = RULES.get(type(node))
    return [] if rule is None else [(kind, node, new) for kind, new in rule(node)]


def decision(node):
    """The check is never made, or the branch is taken where it should not."""
    if len(node.body) == 1 and isinstance(node.body[0], ast.Raise) and not node.orelse:
        return "removed check", node.test, ast.Constant(False)
    return "condition", node.test, ast.UnaryOp(ast.Not(), node.test)


def binary(node):
    """Another operator, or one of the two terms or factors is missing."""
    if is_text(node.left) or is_text(node.right) or is_type(node.right):
        return []
    found = []
    if type(node.op) in OTHER:
        other = OTHER[type(node.op)]()
        found.append(("operator", ast.BinOp(node.left, other, node.right)))
    if isinstance(node.op, TERMS):
        found.append(("dropped term", node.left))
    if isinstance(node.op, ast.Add | ast.Mult):
        found.append(("dropped term", node.right))
    if isinstance(node.op, ast.Sub):
        found.append(("dropped term", ast.UnaryOp(ast.USub(), node.right)))
    return found


def is_text(node):
    """Whether an expression is a text or a list that is written down."""
    texts = isinstance(node, ast.Constant) and isinstance(node.value, str | bytes)
    return texts or isinstance(node, ast.JoinedStr | ast.List | ast.Tuple)


def is_type(node):
    """Whether an expression names a type, as on the right of ``int | None``."""
    name = ast.unparse(node).split(".")[-1]
    kinds = {"None", "int", "float", "str", "bool", "list", "tuple", "dict", "set"}
    return name in kinds or (name[:1].isupper() and not name.isupper())


def unary(node):
    """The sign, or the negation, is missing."""
    if isinstance(node.op, ast.USub | ast.Not):
        return [("operator", node.operand)]
    return []


def constant(node):
    """Another number; True in place of False."""
    value = node.value
    if isinstance(value, bool):
        return [("constant", ast.Constant(not value))]
    if isinstance(value, int):
        return [("constant", ast.Constant(value + 1))]
    if isinstance(value, float):
        size = abs(value)
        if size == 0:
            return [("constant", ast.Constant(1.0))]
        if TOLERANCE <= size <= 1e6:
            return [("constant", ast.Constant(2 * value))]
    return []


def comparison(node):
    """Equality comes or goes, or the opposite is asked."""
    if len(node.ops) > 1:
        return []
    others = COMPARED[type(node.ops[0])]
    return [
        ("comparison", ast.Compare(node.left, [other()], node.comparators))
        for other in others
    ]


def boolean(node):
    """``or`` in place of ``and``, or one of the operands is missing."""
    other = ast.Or() if isinstance(node.op, ast.And) else ast.And()
    found = [("operator", ast.BoolOp(other, node.values))]
    for k in range(len(node.values)):
        rest = node.values[:k] + node.values[k + 1 :]
        left = rest[0] if len(rest) == 1 else ast.BoolOp(node.op, rest)
        found.append(("dropped condition", left))
    return found


def turned(node):
    """The two branches of an expression change places."""
    return [("condition", ast.IfExp(node.test, node.orelse, node.body))]


def call(node):
    """min in place of max, and the like; the size without abs."""
    name = called(node)
    if name == "abs" and len(node.args) == 1:
        return [("function", node.args[0])]
    if name not in FUNCTIONS:
        return []
    other = FUNCTIONS[name]
    if isinstance(node.func, ast.Name):
        function = ast.Name(other)
    else:
        function = ast.Attribute(node.func.value, other)
    return [("function", ast.Call(function, node.args, node.keywords))]


def attribute(node):
    """A matrix in place of its transpose."""
    return [("operator", node.value)] if node.attr == "T" else []


def statement(node):
    """A call whose value nobody uses is missing."""
    if not isinstance(node.value, ast.Call) or left_alone(node.value):
        return []
    checks = called(node.value).lstrip("_").startswith(CHECKS)
    return [("removed check" if checks else "dropped statement", ast.Pass())]


def augmented(node):
    """-= in place of +=, or the statement is missing."""
    found = [("dropped statement", ast.Pass())]
    if type(node.op) in OTHER and not is_text(node.value):
        other = OTHER[type(node.op)]()
        found.append(("operator", ast.AugAssign(node.target, other, node.value)))
    return found


RULES = {
    ast.BinOp: binary,
    ast.UnaryOp: unary,
    ast.Constant: constant,
    ast.Compare: comparison,
    ast.BoolOp: boolean,
    ast.IfExp: turned,
    ast.Call: call,
    ast.Attribute: attribute,
    ast.Expr: statement,
    ast.AugAssign: augmented,
}
