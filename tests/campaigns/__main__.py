"""Campaigns: long runs that search for wrong results; cells are stored as in studies.

``PYTHONPATH=tests python -m campaigns --out results fuzz --count 100 --seed 1``, or ``robustness
--rows "usual,gamma 1e+06"``, or ``crossings --rows "order 2,friction"``, or ``derivatives``,
or ``hidden --count 400``, or ``equilibria``, or ``cones``, or ``receipts``, ``intervals``,
``limits``, ``shakedown``, ``proximal``, ``verdicts``, or ``foreign --beds FOLDER`` with what
``campaigns.beds`` gathers, or ``mutants``.
"""

import argparse
import re
from pathlib import Path

from campaigns.cones import Cones
from campaigns.crossings import Crossings
from campaigns.cubes import Cubes
from campaigns.derivatives import Derivatives
from campaigns.equilibria import Equilibria
from campaigns.foreign import Foreign
from campaigns.fuzz import Fuzz
from campaigns.hidden import Hidden
from campaigns.intervals import Intervals, Verdicts
from campaigns.limits import Limits
from campaigns.mutants import Mutants
from campaigns.proximal import ProximalSteps
from campaigns.receipts import Receipts
from campaigns.rings import Rings
from campaigns.robustness import Robustness
from campaigns.shakedown import Shakedowns
from campaigns.squares import Squares
from ngsolve import SetNumThreads


def rows(text):
    """The entries of a list, separated by commas without a space."""
    return re.split(",(?! )", text)


def arguments():
    """The parser of the command line."""
    parser = argparse.ArgumentParser(prog="python -m campaigns", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out"))
    campaigns = parser.add_subparsers(dest="campaign", required=True)
    fuzz = campaigns.add_parser("fuzz", help="random problems by two methods")
    fuzz.set_defaults(kind=Fuzz, options=("count", "seed"))
    fuzz.add_argument("--count", type=int, default=Fuzz.count)
    fuzz.add_argument("--seed", type=int, default=Fuzz.seed)
    extremes = campaigns.add_parser(
        "robustness", help="data at their extremes, all methods"
    )
    extremes.set_defaults(kind=Robustness, options=("rows", "limit"))
    extremes.add_argument("--rows", type=rows)
    extremes.add_argument("--limit", type=int, default=Robustness.limit)
    bounds = campaigns.add_parser(
        "crossings", help="bounds of random problems, fine references"
    )
    bounds.set_defaults(kind=Crossings, options=("count", "seed", "rows"))
    bounds.add_argument("--count", type=int, default=Crossings.count)
    bounds.add_argument("--seed", type=int, default=Crossings.seed)
    bounds.add_argument("--rows", type=rows, default=Crossings.rows)
    friction = campaigns.add_parser(
        "equilibria", help="friction on few rows, all contact states enumerated"
    )
    friction.set_defaults(kind=Equilibria, options=("count", "seed", "rows"))
    friction.add_argument("--count", type=int, default=Equilibria.count)
    friction.add_argument("--seed", type=int, default=Equilibria.seed)
    friction.add_argument("--rows", type=rows, default=Equilibria.rows)
    cones = campaigns.add_parser(
        "cones", help="random convex problems, conic programming"
    )
    cones.set_defaults(kind=Cones, options=("count", "seed"))
    cones.add_argument("--count", type=int, default=Cones.count)
    cones.add_argument("--seed", type=int, default=Cones.seed)
    slopes = campaigns.add_parser(
        "derivatives", help="gradients of random problems, differences"
    )
    slopes.set_defaults(kind=Derivatives, options=("count",))
    slopes.add_argument("--count", type=int, default=Derivatives.count)
    rings = campaigns.add_parser("rings", help="bounds of bodies of revolution")
    rings.set_defaults(kind=Rings, options=())
    squares = campaigns.add_parser("squares", help="bounds on quadrilaterals")
    squares.set_defaults(kind=Squares, options=("fine",))
    squares.add_argument("--fine", type=int, default=Squares.fine)
    cubes = campaigns.add_parser("cubes", help="bounds on hexahedra")
    cubes.set_defaults(kind=Cubes, options=())
    narrow = campaigns.add_parser(
        "hidden", help="bounds for data that quadrature misses"
    )
    narrow.set_defaults(kind=Hidden, options=("count", "seed"))
    narrow.add_argument("--count", type=int, default=Hidden.count)
    narrow.add_argument("--seed", type=int, default=Hidden.seed)
    widths = campaigns.add_parser("intervals", help="intervals of goals, fine values")
    widths.set_defaults(kind=Intervals, options=("count", "seed", "rows"))
    widths.add_argument("--count", type=int, default=Intervals.count)
    widths.add_argument("--seed", type=int, default=Intervals.seed)
    widths.add_argument("--rows", type=rows, default=Intervals.rows)
    answers = campaigns.add_parser("verdicts", help="limits close to fine values")
    answers.set_defaults(kind=Verdicts, options=("count", "seed"))
    answers.add_argument("--count", type=int, default=Verdicts.count)
    answers.add_argument("--seed", type=int, default=Verdicts.seed)
    limits = campaigns.add_parser("limits", help="limit loads of random bodies")
    limits.set_defaults(kind=Limits, options=("count", "solids", "seed"))
    limits.add_argument("--count", type=int, default=Limits.count)
    limits.add_argument("--solids", type=int, default=Limits.solids)
    limits.add_argument("--seed", type=int, default=Limits.seed)
    varying = campaigns.add_parser("shakedown", help="loads that vary, known factors")
    varying.set_defaults(kind=Shakedowns, options=("width",))
    varying.add_argument("--width", type=float, default=Shakedowns.width)
    steps = campaigns.add_parser("proximal", help="limit loads by proximal steps")
    steps.set_defaults(kind=ProximalSteps, options=("count",))
    steps.add_argument("--count", type=int, default=ProximalSteps.count)
    files_of_claims = campaigns.add_parser("receipts", help="receipts, changed")
    files_of_claims.set_defaults(kind=Receipts, options=("count", "each", "seed"))
    files_of_claims.add_argument("--count", type=int, default=Receipts.count)
    files_of_claims.add_argument("--each", type=int, default=Receipts.each)
    files_of_claims.add_argument("--seed", type=int, default=Receipts.seed)
    files = campaigns.add_parser("foreign", help="mesh files of other projects")
    files.set_defaults(kind=Foreign, options=("beds", "nodes"))
    files.add_argument("--beds", type=Path, default=Foreign.beds)
    files.add_argument("--nodes", type=int, default=Foreign.nodes)
    faults = campaigns.add_parser("mutants", help="faults that tests should detect")
    faults.set_defaults(
        kind=Mutants,
        options=(
            "count",
            "seed",
            "rows",
            "map",
            "seconds",
            "again",
            "judged",
            "trusted",
        ),
    )
    faults.add_argument("--count", type=int, default=Mutants.count)
    faults.add_argument("--seed", type=int, default=Mutants.seed)
    faults.add_argument("--rows", type=rows, default=Mutants.rows)
    faults.add_argument("--map", type=Path, default=Mutants.map)
    faults.add_argument("--seconds", type=float, default=Mutants.seconds)
    faults.add_argument("--again", action="store_true")
    faults.add_argument("--judged", action="store_true")
    faults.add_argument("--trusted", action="store_true")
    return parser


def main(words=None):
    """Run a campaign and print the names of the files written."""
    given = arguments().parse_args(words)
    options = {name: getattr(given, name) for name in given.options}
    work = given.kind(given.out, progress=print, **options)
    for path in work.write(work.run()):
        print(path)


if __name__ == "__main__":
    SetNumThreads(1)
    main()
