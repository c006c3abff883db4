"""How much a reader has to hold in mind: tokens, packed assignments, length of code lines by room.

``python tests/house/density.py`` prints the table and the ten densest functions; comments and
docstrings do not count.
"""

import ast
import io
import re
import tokenize
from dataclasses import dataclass
from functools import cache

from sources import ROOT, TOP_LEVEL, modules

LAYOUT = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
}


@dataclass
class Density:
    """Sums over some code."""

    packed: int = 0  # assignments a, b = x, y
    lines: int = 0
    characters: int = 0

    def add(self, text):
        """Count a module."""
        inside = list(ast.walk(ast.parse(text)))
        documented = lines_of_docstrings(inside)
        self.packed += sum(map(is_packed, inside))
        for number, line in enumerate(text.split("\n"), 1):
            line = line.strip()
            if line and not line.startswith("#") and number not in documented:
                self.lines += 1
                self.characters += len(line)

    @property
    def packed_per_100_lines(self):
        return 100 * self.packed / self.lines

    @property
    def mean_line(self):
        return self.characters / self.lines


def lines_of_docstrings(inside):
    """The numbers of the lines of strings that stand alone among the nodes of a module."""
    strings = (
        node
        for node in inside
        if isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    )
    return {n for node in strings for n in range(node.lineno, node.end_lineno + 1)}


def is_packed(node):
    """Whether a statement assigns several values at once."""
    return (
        isinstance(node, ast.Assign)
        and isinstance(node.value, ast.Tuple)
        and any(isinstance(target, ast.Tuple) for target in node.targets)
    )


def tokens_of(text):
    """The number of tokens of a module."""
    documented = lines_of_docstrings(ast.walk(ast.parse(text)))
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    return sum(
        token.type not in LAYOUT and token.start[0] not in documented
        for token in tokens
    )


FEWEST_LINES = 8
"""Lines of code of the functions that are looked at one by one."""


WORD = re.compile(r"""(?P<comment>#.*)|"[^"]*"|'[^']*'|\w+|[^\w\s]""")
"""A token, near enough, and much faster: operators of two characters are two."""


def words_of(line):
    """The number of tokens on a line."""
    return sum(word["comment"] is None for word in WORD.finditer(line))


@cache
def densest():
    """(tokens on a line of code, module.function), the densest functions of the package first."""
    found = []
    for module, tree in modules().items():
        path = ROOT / module.replace(".", "/")
        path = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
        lines = path.read_text(encoding="utf-8").split("\n")
        for function in functions_in(tree.body):
            body = function.body[1:] if ast.get_docstring(function) else function.body
            first = body[0].lineno if body else function.end_lineno + 1
            words = [words_of(line) for line in lines[first - 1 : function.end_lineno]]
            code = [number for number in words if number]
            if len(code) >= FEWEST_LINES:
                found.append((sum(code) / len(code), f"{module}.{function.name}"))
    return sorted(found, reverse=True)


def functions_in(statements):
    """The functions of a module and the methods of its classes."""
    for node in statements:
        if isinstance(node, ast.FunctionDef):
            yield node
        elif isinstance(node, ast.ClassDef):
            yield from functions_in(node.body)


def texts(root=ROOT):
    """Room -> the texts of its modules, and 'all' -> those of all rooms."""
    found = {"all": []}
    for path in sorted((root / "ngepc").glob("*/*.py")):
        room = path.parent.name
        if room not in TOP_LEVEL:
            text = path.read_text(encoding="utf-8")
            for name in (room, "all"):
                found.setdefault(name, []).append(text)
    return found


def density(modules):
    """The sums over the texts of some modules."""
    found = Density()
    for text in modules:
        found.add(text)
    return found


if __name__ == "__main__":
    for name, of_room in sorted(texts().items()):
        here = density(of_room)
        packed = f"{here.packed_per_100_lines:.1f}"
        tokens = sum(map(tokens_of, of_room))
        print(f"| `{name}` | {tokens} | {packed} | {here.mean_line:.0f} |")
    for per_line, name in densest()[:10]:
        print(f"{per_line:.1f} {name}")
