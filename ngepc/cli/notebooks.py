"""``ngepc notebooks DIR``: the notebooks that come with the package, copied to a folder."""

import argparse
import shutil
import sys
from pathlib import Path

import ngepc
from ngepc.cli.arguments import location


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument(
        "folder", metavar="DIR", type=location, help="where to; it is made if missing"
    )
    parser.add_argument("--force", action="store_true", help="replace files that are there already")


def source() -> Path:
    """The folder of the notebooks: inside the installed package, or beside it in a checkout.

    Raises
    ------
    FileNotFoundError
        If they were not installed.
    """
    package = Path(ngepc.__file__).resolve().parent
    for folder in (package / "notebooks", package.parent / "notebooks"):
        if any(folder.glob("*.ipynb")):
            return folder
    raise FileNotFoundError(f"there are no notebooks beside {package}: install ngepc again")


def copy_notebooks(folder: Path, force: bool = False) -> list[Path]:
    """Copy all notebooks, exercises and solutions included.

    Parameters
    ----------
    folder
        Where to; it is made if missing.
    force
        Whether to replace files that are there already.

    Returns
    -------
    list of Path
        The copies.

    Raises
    ------
    FileExistsError
        If one of the files is there and ``force`` is not set; then nothing is copied.
    """
    start = source()
    targets = {p: folder / p.relative_to(start) for p in sorted(start.rglob("*.ipynb"))}
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
    copies = copy_notebooks(args.folder, args.force)
    sys.stdout.write(
        f"wrote {len(copies)} notebooks to {args.folder}\n"
        f"open the first one with: jupyter lab {copies[0]}\n"
    )
    return 0
