"""A plugin of pytest that writes the processor time of each test.

With ``-p campaigns.spent`` and the file's name in the variable SPENT it appends lines such as
``1.25 tests/local/test_forms.py::test_a``; fixtures belong to the first test that needs them, and
other programs to the test that waits for them.
"""

import os
import resource

import pytest


def used():
    """Seconds of this process and of those that it has waited for."""
    usages = [
        resource.getrusage(resource.RUSAGE_SELF),
        resource.getrusage(resource.RUSAGE_CHILDREN),
    ]
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item):
    """Add the line of a test."""
    begin = used()
    result = yield
    with open(os.environ["SPENT"], "a", encoding="utf-8") as file:
        file.write(f"{used() - begin:.2f} {item.nodeid}\n")
    return result
