"""Every public name exists and says what it is."""

import inspect

import pytest

import ngepc


@pytest.mark.parametrize("name", sorted(set(ngepc.__all__) - {"__version__"}))
def test_public_name_is_documented(name):
    value = getattr(ngepc, name)
    assert inspect.getdoc(value)
    if inspect.isfunction(value):
        signature = inspect.signature(value)
        assert signature.return_annotation is not inspect.Signature.empty
        for parameter in signature.parameters.values():
            assert parameter.annotation is not inspect.Parameter.empty, parameter.name


def test_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'Nothing'"):
        ngepc.Nothing  # noqa: B018
