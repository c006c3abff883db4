"""The work of ``ngepc check``: it loads neither NGSolve nor anything else that solves."""

import argparse
import sys
from zipfile import is_zipfile

from ngepc.goals import check_receipt


def check_file(args: argparse.Namespace) -> int:
    """``ngepc check FILE``: check a receipt, as ``check_receipt.py`` does alone."""
    if not args.receipt.is_file():
        raise ValueError(f"{args.receipt}: no such file")
    if not is_zipfile(args.receipt):
        sys.stdout.write(
            f"{args.receipt}: FAIL: no receipt, as ngepc.write_receipt makes\n"
        )
        return 1
    try:
        shown = check_receipt.check(str(args.receipt))
    except Exception as error:  # whatever is wrong with a file, it does not pass
        reason = error if isinstance(error, ValueError) else repr(error)
        sys.stdout.write(f"{args.receipt}: FAIL: {reason}\n")
        return 1
    sys.stdout.write(f"{args.receipt}: PASS: {shown}\n")
    return 0
