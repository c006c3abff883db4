"""Tables of pages whose numbers are from results/: each is one of these numbers, rounded."""

import csv
import re

import pytest
from sources import ROOT

QUOTED = [
    ("docs/cost.md", "by NGSolve: assembly", "counts"),
    ("docs/differentiability.md", "Bumps with a plateau", "differentiability"),
    ("docs/differentiability.md", "Logarithmic bumps", "differentiability"),
    ("docs/error_bound.md", "`solve_to` on the examples, order two", "bounds"),
    ("docs/error_bound.md", "whose least energy is 0.05917", "bounds"),
    ("docs/error_bound.md", "or their inner vertices are moved", "squares"),
    ("docs/error_bound.md", "They are regular, or their vertices", "cubes"),
    ("docs/error_bound.md", "Other references are lower bounds", "rings"),
    ("docs/hardening.md", "## Newton steps of all laws", "counts"),
    ("docs/howto/distributed.md", "## How it scales", "processes two_processes"),
    ("docs/howto/large_bodies.md", "all coarser meshes included", "large order_two"),
    ("docs/limit_loads.md", "**Proximal steps instead", "proximal"),
    ("docs/locking.md", "**Cantilever**", "locking"),
    ("docs/locking.md", "**Prandtl's punch**", "locking"),
    ("docs/locking.md", "**Cook's membrane**", "locking"),
    ("docs/method/exact.md", "**How stable are the pressures?**", "overlap"),
    ("docs/method/exact.md", "**Overlap between the nodes.**", "overlap"),
    ("docs/step42.md", "By symmetry the study uses", "step42"),
]
"""Page, words before the table, and the names of results or of their folders."""
NUMBER = r"[+-]?(?:\d{1,3}(?:,\d{3})+|\d+)?(?:\.\d+|\d)(?:e-?\d+)?"
SCALES = (1, 100, 1e-3)  # percents, and GB of MB


def decimals(number):
    """How many decimals a number is printed with, a power of ten taken into account."""
    mantissa, _, power = number.partition("e")
    return len(mantissa.partition(".")[2]) - int(power or 0)


def numbers(text):
    """The numbers in a text, as they are printed."""
    return re.findall(NUMBER, text)


def value(number):
    return float(number.replace(",", ""))


def printed(page, words):
    """The numbers of the first table after these words, without its head and first column."""
    after = (ROOT / page).read_text(encoding="utf-8").split(words)
    assert len(after) == 2, f"{words} stands {len(after) - 1} times in {page}"
    rows = re.search(r"(?:^\|.*\n)+", after[1], re.MULTILINE).group().splitlines()[2:]
    cells = " ".join(cell for row in rows for cell in row.split("|")[2:])
    return numbers(re.sub(r"\]\([^)]*\)", "", cells))


def measured(names):
    """All numbers of some results."""
    files = [
        path
        for name in names.split()
        for pattern in (f"{name}.csv", f"{name}/*.csv")
        for path in (ROOT / "results").glob(pattern)
    ]
    cells = (cell for path in files for row in csv.reader(path.open()) for cell in row)
    return [value(number) for cell in cells for number in numbers(cell)]


def strangers(quoted, found):
    """Those of the numbers on a page that are no roundings of numbers found."""
    return [
        number
        for number in quoted
        if not any(
            abs(scale * x - value(number)) <= 0.5001 * 10.0 ** -decimals(number)
            for x in found
            for scale in SCALES
        )
    ]


@pytest.mark.parametrize(("page", "words", "names"), QUOTED)
def test_tables_quote_the_results(page, words, names):
    quoted = printed(page, words)
    assert len(quoted) > 10
    assert strangers(quoted, measured(names)) == []


def test_numbers_that_have_changed_are_seen():
    assert (
        strangers(["1.05", "33.6", "1.7", "1,047"], [1.0454, 0.336, 1678, 1047]) == []
    )
    assert strangers(
        ["1.04", "+33.5", "1.6", "1,046"], [1.0454, 0.336, 1678, 1047]
    ) == ["1.04", "+33.5", "1.6", "1,046"]
    assert strangers(["1.6e-3", "2e-6"], [0.00164, 1.8e-6]) == []
    assert strangers(["1.7e-3"], [0.00164]) == ["1.7e-3"]
