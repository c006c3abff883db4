"""The comparison table of ``paper.md``: ``python paper/table.py`` writes it anew.

It is made from ``results/accuracy.json``, which ``ngepc study accuracy`` writes.
"""

import json
from collections.abc import Iterator
from pathlib import Path

HERE = Path(__file__).parent
PAPER = HERE / "paper.md"
RESULTS = HERE.parent / "results" / "accuracy.json"

PROGRAMS = {
    "default": "ngepc",
    "default, bricks": "ngepc, bricks",
    "ccx": "CalculiX",
    "ccx, bricks": "CalculiX, bricks",
}
"""Programs of the study -> names in the table."""

BEGIN = "<!-- table -->\n"
END = "<!-- end of table -->\n"


def lines(cells: list[dict]) -> Iterator[str]:
    """The table: problem, program, CPU seconds to 5 and 1 percent, finest error, steps."""
    yield "| problem | program | s to 5 % | s to 1 % | finest error (%) | steps |"
    yield "| --- | --- | --- | --- | --- | --- |"
    for cell in cells:
        if cell["program"] not in PROGRAMS:
            continue
        shown = [cell["case"], PROGRAMS[cell["program"]], cell["five"], cell["one"]]
        shown += [f"{cell['finest']:.2g}", str(cell["steps_there"])]
        yield f"| {' | '.join(shown)} |"


def with_table(text: str) -> str:
    """The text of the paper with the table of the committed results."""
    cells = json.loads(RESULTS.read_text(encoding="utf-8"))["cells"]
    before, _, rest = text.partition(BEGIN)
    after = rest.partition(END)[2]
    table = "\n".join(lines(cells))
    return f"{before}{BEGIN}{table}\n{END}{after}"


if __name__ == "__main__":
    PAPER.write_text(with_table(PAPER.read_text(encoding="utf-8")), encoding="utf-8")
