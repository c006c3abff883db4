"""Processes that share a body: what a monitor of one of them ends, it ends on all."""

import sys

import pytest
import teams

from ngepc.model.processes import Team


def endings_of(ends):
    """What the monitors' calls raise on each of three processes; the second one calls ``ends``."""

    def work(comm):
        team = Team(comm)

        def monitor(seen):
            if comm.rank == 1:
                ends()

        try:
            team.show(monitor, None)
        except (StopIteration, SystemExit) as error:
            return type(error), getattr(error, "code", None)

    return teams.run(3, work)


def stop():
    raise StopIteration


@pytest.mark.parametrize("status", [0, 7, "no licence on this node"])
def test_a_monitor_that_leaves_on_one_process_leaves_on_all(status):
    assert endings_of(lambda: sys.exit(status)) == 3 * [(SystemExit, status)]


def test_a_monitor_that_stops_one_process_stops_all():
    assert endings_of(stop) == 3 * [(StopIteration, None)]
    assert endings_of(lambda: None) == 3 * [None]
