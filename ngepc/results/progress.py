"""A line of progress on a terminal, without matplotlib."""

from collections.abc import Iterator
from contextlib import contextmanager

from tqdm import tqdm

from ngepc.checks.kinds import require_text
from ngepc.results.outcome import IterationRecord, Monitor


@contextmanager
def progress_line(label: str = "") -> Iterator[Monitor]:
    """A monitor that keeps one line up to date on a terminal; nothing is written anywhere else.

    At the end of ``with progress_line() as monitor:`` the line is removed.  Lines that stay, one
    for each step, are logged: ``logging.basicConfig(level="INFO")``.

    Parameters
    ----------
    label
        What stands in front.
    """
    form = "{desc}{postfix} [{elapsed}]"
    desc = require_text("label", label) or None
    bar = tqdm(desc=desc, leave=False, disable=None, bar_format=form)

    def write(record: IterationRecord) -> None:
        """Show an iterate beside the bar."""
        bar.set_postfix_str(
            f"step {record.iteration}, residual {record.residual_norm:.2e}, in contact "
            f"{record.contact_active:.3g}, plastic {record.plastic_active:.3g}"
        )

    with bar:
        yield write
