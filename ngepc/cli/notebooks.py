"""``ngepc notebooks DIR``: the notebooks that come with the package, copied to a folder."""

import argparse
import shutil
import sys
from pathlib import Path

import ngepc
from ngepc.cli.arguments import location

EXAMPLES = """examples:
  ngepc notebooks mine && jupyter lab mine
  ngepc notebooks mine --solutions --force
"""


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    text = "where to; it is made if missing"
    parser.add_argument("folder", metavar="DIR", type=location, help=text)
    parser.add_argument("--solutions", action="store_true", help="solutions of the exercises, too")
    parser.add_argument("--force", action="store_true", help="replace files that are there already")


def copy_notebooks(folder: Path, force: bool = False, solutions: bool = False) -> list[Path]:
    """Copy all notebooks and exercises; returns the copies.

    Raises
    ------
    FileExistsError
        If one of the files is there and ``force`` is not set; then nothing is copied.
    """
    start = Path(ngepc.__file__).parent / "notebooks"
    wanted = sorted(start.glob("*.ipynb")) + sorted(start.glob("exercises/*.ipynb"))
    wanted += sorted(start.glob("solutions/*.ipynb")) if solutions else []
    if not wanted:
        raise FileNotFoundError(f"there are no notebooks in {start}: install ngepc again")
    targets = {p: folder / p.relative_to(start) for p in wanted}
    present = [str(target) for target in targets.values() if target.exists()]
    if present and not force:
        raise FileExistsError(
            f"{present[0]} is there already ({len(present)} files): give another folder, or "
            "--force to replace them"
        )
    for original, target in targets.items():
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(original, target)
    return list(targets.values())


def run(args: argparse.Namespace) -> int:
    """Copy and say how to go on."""
    copies = copy_notebooks(args.folder, args.force, args.solutions)
    sys.stdout.write(
        f"wrote {len(copies)} notebooks to {args.folder}\n"
        f"open the first one with: jupyter lab {copies[0]}\n"
    )
    return 0
