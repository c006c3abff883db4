"""How much a reader has to hold in mind: tokens, packed assignments, length of code lines by room.

``python tests/house/density.py`` prints the table; comments and docstrings do not count.
"""

import ast
import io
import tokenize
from dataclasses import dataclass

from sources import ROOT, TOP_LEVEL

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
        tree = ast.parse(text)
        documented = lines_of_docstrings(tree)
        self.packed += sum(map(is_packed, ast.walk(tree)))
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


def lines_of_docstrings(tree):
    """The numbers of the lines of strings that stand alone."""
    strings = (
        node
        for node in ast.walk(tree)
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
    documented = lines_of_docstrings(ast.parse(text))
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    return sum(
        token.type not in LAYOUT and token.start[0] not in documented
        for token in tokens
    )


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
    for name, modules in sorted(texts().items()):
        here = density(modules)
        packed = f"{here.packed_per_100_lines:.1f}"
        tokens = sum(map(tokens_of, modules))
        print(f"| `{name}` | {tokens} | {packed} | {here.mean_line:.0f} |")
