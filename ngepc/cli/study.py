"""``ngepc study NAME``: the tables and figures of the paper, one module ``study_NAME`` each."""

import argparse
import importlib

STUDIES = {
    "table1": "Newton steps over meshes and gamma, Example (a)",
    "table2": "Newton steps over meshes and gamma, Example (b)",
    "table3": "path-following for Example (b), and direct solves beside it",
    "figures": "Figures 2, 3, 5 and 6 at the end of paths in gamma",
    "figure4": "convergence quotients of the last Newton steps",
    "duality": "the duality gap and its parts along paths in gamma",
    "differentiability": "the norm gap of Definition 6.1, counts without the Tichonov term",
    "solvers": "coupled, exact and primal side by side, cold and nested",
    "step42": "dual against primal on the body of step-42, with both errors",
    "fuzz": "random problems by the primal and by the dual method, judged",
    "robustness": "data at their extremes: iterations and statuses of all methods",
}


def configure(parser: argparse.ArgumentParser) -> None:
    """Add one subcommand for each study."""
    studies = parser.add_subparsers(dest="study", required=True, metavar="STUDY")
    for name, text in STUDIES.items():
        module = importlib.import_module(f"ngepc.cli.study_{name}")
        sub = studies.add_parser(name, help=text, description=text + ".")
        module.configure(sub)
        sub.set_defaults(run_study=module.run)


def run(args: argparse.Namespace) -> int:
    """Run the chosen study, after a look at whether its results can be written."""
    from ngepc.results.files import check_folder

    check_folder(args.out)
    return args.run_study(args)
