"""Nonsense for arguments: its kinds, what an annotation makes legal, what became of the rest."""

import inspect
import math
import re
import types
import typing
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from ngsolve import CF, CoefficientFunction, Mesh, x

from ngepc.checks.arguments import (
    require_component,
    require_datum,
    require_integer,
    require_number,
)
from ngepc.checks.declared import Check, declared_check
from ngepc.checks.kinds import require_flag, require_text
from ngepc.checks.sentences import in_words
from ngepc.geometries import lshape

MESH = lshape.paper_mesh(21)

NONSENSE = {
    "None": None,
    "True": True,
    "a text": "junk",
    "an empty text": "",
    "bytes": b"junk",
    "a complex number": 1j,
    "NaN": math.nan,
    "infinity": math.inf,
    "minus infinity": -math.inf,
    "zero": 0,
    "a negative number": -1,
    "a fraction": 1.5,
    "an integer too large": 10**400,
    "an object": object(),
    "a function": math.sin,
    "a class": int,
    "a set": {1},
    "an empty list": [],
    "an empty tuple": (),
    "a list": [1, "a"],
    "a mapping": {"a": 1},
    "a mapping of junk": {"left": "junk"},
    "a mapping of a mapping": {"left": {"right": 1.0}},
    "a mapping by number": {3: (1.0, 1.0)},
    "a mapping to NaN": {"left": (math.nan, math.nan)},
    "an array of NaN": np.full(2, math.nan),
    "a matrix": np.eye(4),
    "a vector coefficient": CF((1, 2, 3)),
    "a coefficient of nine": CF((1.0,) * 9, dims=(3, 3)),
    "a coefficient of NaN": CF(math.nan) * x,
    "a mesh": MESH,
}

NOTHING = frozenset()
POSITIVE = frozenset({"a fraction"})
NOT_NEGATIVE = POSITIVE | {"zero"}
NUMBERS = NOT_NEGATIVE | {"a negative number"}
TEXTS = frozenset({"a text", "an empty text"})
UNSEEN = frozenset({"a coefficient of NaN"})
"""What only a mesh shows."""
COEFFICIENTS = frozenset(kind for kind in NONSENSE if "coefficient" in kind)
CALLABLE = COEFFICIENTS | {"a function", "a class", "a mesh"}
"""What can be called; what it does then is up to the user, as with any function of theirs."""

NEED = (
    "needed", "needs", "one of", "legal", "the fields are", "give ", "asks for",
    "this mesh has", "boundaries are", "are trace-free",
)  # fmt: skip
"""Words that say what is legal."""


@dataclass(frozen=True)
class Use:
    """A legal use of a callable, from which its nonsense follows.

    Parameters
    ----------
    call
        The callable.
    legal
        Arguments of a legal call.
    may
        Argument -> kinds that are legal for it, where its annotation does not tell.
    skip
        Arguments that are not checked here.
    """

    call: Callable
    legal: dict = field(default_factory=dict)
    may: dict = field(default_factory=dict)
    skip: tuple = ()

    def arguments(self) -> list[inspect.Parameter]:
        """The arguments that nonsense is tried for."""
        variadic = inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD
        found = inspect.signature(self.call).parameters.values()
        return [p for p in found if p.name not in self.skip and p.kind not in variadic]

    def cases(self) -> Iterator[tuple[str, str]]:
        """Pairs (argument, kind of nonsense) that must be refused."""
        for parameter in self.arguments():
            hint = resolved(parameter.annotation, self.call)
            legal = self.may.get(parameter.name, legal_kinds(hint)) | none_of(
                parameter, hint
            )
            yield from (
                (parameter.name, kind) for kind in NONSENSE if kind not in legal
            )

    def failures(self) -> list[str]:
        """What is wrong with the answers to nonsense, one line for each case."""
        found = (
            (a, kind, self._failure(a, NONSENSE[kind])) for a, kind in self.cases()
        )
        return [f"{a}, {kind}: {failure}" for a, kind, failure in found if failure]

    def _failure(self, argument: str, value: object) -> str:
        try:
            self.call(**{**self.legal, argument: value})
        except (TypeError, ValueError) as error:
            message = str(error)
            if argument not in message:
                return f"the argument is not named: {message}"
            if not names_the_value(message, value):
                return f"the value is not named: {message}"
            return (
                ""
                if any(word in message for word in NEED)
                else f"no legal value: {message}"
            )
        except Exception as error:  # the test judges its type
            return f"{type(error).__name__}: {error}"
        return "accepted"


def resolved(annotation: object, call: Callable) -> object:
    """The annotation itself for its text, where its names are known when the module runs."""
    if not isinstance(annotation, str):
        return annotation
    function, names = inspect.unwrap(call), {}
    for owner in reversed(getattr(function, "__mro__", (function,))):
        names |= vars(inspect.getmodule(owner))
    try:
        return eval(annotation, names)
    except NameError:
        return annotation


def parts_of(hint: object) -> tuple:
    """The members of a union, or the hint alone."""
    union = isinstance(hint, types.UnionType) or typing.get_origin(hint) is typing.Union
    return typing.get_args(hint) if union else (hint,)


def declared_kinds(check: Check) -> frozenset:
    """Kinds of nonsense that a declared check makes legal: the numbers in its range."""
    rule, bounds = check.func, {"least": -math.inf, "most": math.inf, **check.keywords}
    if rule in (require_text, require_flag):
        return TEXTS if rule is require_text else frozenset({"True"})
    if rule is require_component:
        return frozenset({"zero"})
    if rule not in (require_number, require_integer, require_datum):
        return NOTHING
    tried = {"zero": 0, "a negative number": -1, "a fraction": 1.5}
    legal = {
        kind
        for kind, number in tried.items()
        if bounds["least"] <= number <= bounds["most"]
        and number < bounds.get("below", math.inf)
        if not (bounds.get("strict") and number == bounds["least"])
        if not (rule is require_integer and kind == "a fraction")
    }
    return frozenset(legal) | (UNSEEN if rule is require_datum else NOTHING)


def legal_kinds(hint: object) -> frozenset:
    """Kinds of nonsense that an annotation makes legal: texts for a text, > 0 for a number."""
    check = declared_check(hint)
    if check:
        return declared_kinds(check)
    parts = {part for part in parts_of(hint) if part is not type(None)}
    text = str(hint)
    if any(
        typing.get_origin(part) is typing.get_origin(Callable[[], None])
        for part in parts
    ):
        return CALLABLE
    if re.search(r"\bCallable\b", text):
        return CALLABLE
    if re.search(r"\bPath(Like)?\b", text):
        return frozenset({"a text"})
    return {
        frozenset({str}): TEXTS,
        frozenset({bool}): frozenset({"True"}),
        frozenset({float}): POSITIVE,
        frozenset({Mesh}): frozenset({"a mesh"}),
    }.get(frozenset(parts), NOTHING)


def none_of(parameter: inspect.Parameter, hint: object) -> set:
    """None, if it is the default or in the annotation."""
    optional = parameter.default is None or type(None) in parts_of(hint)
    return {"None"} if optional else set()


def names_the_value(message: str, value: object) -> bool:
    """The value itself, one of its entries, or for coefficients what is wrong with them."""
    texts = [repr(value), f"{value}", in_words(value), "has shape"]
    if isinstance(value, CoefficientFunction):
        texts += ["is NaN or infinite at", "has trace up to"]
    if isinstance(value, list | tuple | dict | np.ndarray):
        texts += [in_words(entry) for entry in value]
    return any(text in message for text in texts)
