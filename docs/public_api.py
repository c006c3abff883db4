"""The public interface as one list: ``python docs/public_api.py`` writes ``public_api.txt``.

A line for each name of ``ngepc`` with its arguments, for each public member of its classes, and for
each command with its options.  A test compares the file with the package, so that no change of the
interface goes unnoticed; ``versions.md`` says which change needs which version.
"""

import dataclasses
import inspect
from collections.abc import Iterator
from pathlib import Path

import ngepc
from ngepc.cli.commands import COMMANDS, STUDIES

PAGE = Path(__file__).with_name("public_api.txt")


def arguments(function: object) -> str:
    """The names of the arguments; '=' behind those with a default."""
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        return ""
    shown = []
    for parameter in parameters:
        stars = {parameter.VAR_POSITIONAL: "*", parameter.VAR_KEYWORD: "**"}
        default = "" if parameter.default is parameter.empty else "="
        shown.append(f"{stars.get(parameter.kind, '')}{parameter.name}{default}")
    return f"({', '.join(shown)})"


def members(name: str, value: type) -> Iterator[str]:
    """The public methods, properties and fields of a class of the package."""
    fields = [f.name for f in dataclasses.fields(value)] if is_data(value) else []
    own = {key for key in dir(value) if not key.startswith("_")} | set(fields)
    for key in sorted(own):
        if key.startswith("_"):
            continue
        member = inspect.getattr_static(value, key, None)
        called = getattr(value, key) if inspect.isroutine(member) else None
        yield f"{name}.{key}{arguments(called) if called else ''}"


def is_data(value: object) -> bool:
    """Whether it is a dataclass."""
    return dataclasses.is_dataclass(value)


def lines() -> Iterator[str]:
    """The list, sorted by name."""
    for name in sorted(set(ngepc.__all__) - {"__version__"}):
        value = getattr(ngepc, name)
        yield f"{name}{arguments(value)}"
        if inspect.isclass(value) and value.__module__.startswith("ngepc"):
            yield from members(name, value)
    for name, command in COMMANDS.items():
        yield f"ngepc {name} {' '.join(command.options)}".strip()
    for name, study in STUDIES.items():
        yield f"ngepc study {name} {' '.join(study.options)}".strip()


if __name__ == "__main__":
    PAGE.write_text("\n".join(lines()) + "\n", encoding="utf-8")
