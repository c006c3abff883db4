"""``ngepc benchmark``: what a Newton step costs, in linear-elastic solves on the same mesh."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from ngepc.cli.arguments import add_levels, add_out, check_levels, file_name, say

if TYPE_CHECKING:
    from ngepc.studies.benchmark import Measurement

MODES = ("exact", "coupled")


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_levels(parser, 7)
    parser.add_argument("--mode", choices=MODES, action="append", help="default both")
    add_out(parser)
    parser.add_argument(
        "--json", metavar="FILE", type=file_name, help="also write the records there, - for stdout"
    )


def run(args: argparse.Namespace) -> int:
    """Measure, write, name what was written."""
    for name in ("NGS_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ[name] = "1"
    from ngepc.results import records
    from ngepc.results.files import check_folder
    from ngepc.studies.benchmark import NODES, Cell, run_cells
    from ngepc.studies.benchmark_output import write_benchmark

    check_levels(args.levels, len(NODES))
    check_folder(args.out)
    if args.json not in (None, "-"):
        records.check_writable(Path(args.json))
    modes = dict.fromkeys(args.mode or MODES)
    cells = [Cell(mode, nodes) for mode in modes for nodes in NODES[: args.levels]]
    measurements = run_cells(cells, lambda m: say(_line(m)))
    written = write_benchmark(args.out, measurements)
    if args.json is not None:
        text = records.to_json(
            {**records.provenance(), "cells": [m.as_dict() for m in measurements]}
        )
        if args.json == "-":
            sys.stdout.write(text)
        else:
            records.write_text(Path(args.json), text)
            written.append(Path(args.json))
    for path in written:
        say(f"wrote {path}")
    return 0 if all(m.status == "converged" for m in measurements) else 1


def _line(m: Measurement) -> str:
    return (
        f"{m.mode:9s} {m.nodes:6d} nodes: {m.iterations} steps, {m.status}; a step costs "
        f"{m.step_ratio:.2f} elastic solves (mean {m.mean_ratio:.2f}, largest "
        f"{m.largest_ratio:.2f}), {m.step_seconds:.3f} s"
    )
