"""``ngepc notebooks DIR``: the notebooks that come with the package, copied to a folder."""

import argparse
import shutil
import sys
from pathlib import Path

import ngepc


def run(args: argparse.Namespace) -> int:
    """Copy all notebooks and exercises, none if one is there already, and say how to go on."""
    start = Path(ngepc.__file__).parent / "notebooks"
    folders = ("", "exercises", "solutions") if args.solutions else ("", "exercises")
    wanted = [path for folder in folders for path in sorted((start / folder).glob("*.ipynb"))]
    if not wanted:
        raise FileNotFoundError(f"there are no notebooks in {start}: install ngepc again")
    copies = {path: args.folder / path.relative_to(start) for path in wanted}
    present = [str(copy) for copy in copies.values() if copy.exists()]
    if present and not args.force:
        raise FileExistsError(
            f"{present[0]} is there already ({len(present)} files): give another folder, or "
            "--force to replace them"
        )
    for original, copy in copies.items():
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(original, copy)
    sys.stdout.write(
        f"wrote {len(copies)} notebooks to {args.folder}\n"
        f"open the first one with: jupyter lab {copies[wanted[0]]}\n"
    )
    return 0
