"""The option ``--large``, for the largest cases."""


def pytest_addoption(parser):
    parser.addoption("--large", action="store_true", help="the largest cases, too")
