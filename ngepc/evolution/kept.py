"""Finished steps of a history in a temporary file, from which their fields are made when needed.

What a step adds to the steps before is its displacement, N numbers for a node, the plastic strain
gained in it, d numbers for a point, and the forces of its contact rows.  Its problem begins with
the history that the steps before have left: with p_0 and alpha_2 of d numbers each, alpha_1 and
PEEQ, 2 d + 2 numbers for a point.  That could be added up again from the first step on, but then
reading all steps would take the square of their number; it is kept as well.

The file has no name in its folder, so that it is gone with the history, or when the process ends.
"""

from __future__ import annotations

import os
import threading
import weakref
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from tempfile import TemporaryFile
from typing import IO, NamedTuple

import numpy as np
from ngsolve import GridFunction

from ngepc.evolution.memory import Memory
from ngepc.model.data import HISTORY
from ngepc.model.own import require_same_elements
from ngepc.model.problem import Problem
from ngepc.results.fields import Fields


class Place(NamedTuple):
    """Where an array is in a file."""

    first: int
    shape: tuple[int, ...]


class Store:
    """Arrays of numbers in a temporary file; other processes and threads may read it, too."""

    def __init__(self) -> None:
        self._end = 0
        self._one_at_a_time = threading.Lock()

    @cached_property
    def _file(self) -> IO[bytes]:
        """The file, made for the first array."""
        file = TemporaryFile(prefix="ngepc-")  # noqa: SIM115
        weakref.finalize(self, file.close)
        return file

    def put(self, array: np.ndarray) -> Place:
        """Append an array; OSError if there is no room."""
        numbers = np.ascontiguousarray(array, dtype=float)
        with self._one_at_a_time:
            self._file.seek(self._end)
            self._file.write(numbers.tobytes())
            self._file.flush()
            place = Place(self._end, numbers.shape)
            self._end += numbers.nbytes
        return place

    def get(self, place: Place) -> np.ndarray:
        """An array of its own with the numbers that are at a place."""
        array = np.empty(place.shape)
        array.reshape(-1).view(np.uint8)[:] = np.frombuffer(
            self._read(place.first, array.nbytes), dtype=np.uint8
        )
        return array

    def _read(self, first: int, size: int) -> bytes:
        """Bytes from a position on."""
        if hasattr(
            os, "pread"
        ):  # the position in a file is shared with forked processes
            return os.pread(self._file.fileno(), size, first)
        with self._one_at_a_time:
            self._file.seek(first)
            return self._file.read(size)


class KeptFields:
    """The fields of a step whose arrays are in a ``store``; ``before`` is its initial history.

    OSError if there is no room.  Beside the arrays it has the problem of the step without what the
    steps before have left, and the spaces of the functions: of "displacement", of
    "plastic_increment", and with friction of "start", the displacement at which nothing has
    slipped.
    """

    def __init__(self, store: Store, fields: Fields, before: Memory) -> None:
        problem = fields.problem
        functions = {
            "displacement": fields.displacement,
            "plastic_increment": fields.plastic_increment,
        }
        taken = [name for name in HISTORY if name != "initial_strain"]
        if isinstance(problem.initial_displacement, GridFunction):
            functions["start"] = problem.initial_displacement
            taken.append("initial_displacement")
        arrays = {name: f.vec.FV().NumPy() for name, f in functions.items()}
        arrays |= before.arrays
        self._store = store
        self._places = {name: store.put(array) for name, array in arrays.items()}
        self._problem = without(problem, taken)
        self._memory = replace(before, arrays={})
        self._spaces = {name: f.space for name, f in functions.items()}
        self._made: Callable[[], Fields | None] = weakref.ref(fields)

    @property
    def fields(self) -> Fields:
        """The fields, made again unless they are in use.

        ValueError if the mesh has other elements now.
        """
        fields = self._made()
        if fields is None:
            fields = self._again()
            self._made = weakref.ref(fields)
        return fields

    def array(self, name: str) -> np.ndarray:
        """The vector of a function, or an array of the history."""
        return self._store.get(self._places[name])

    def _again(self) -> Fields:
        """The same fields; what they check was checked when the step was solved."""
        require_same_elements(self._problem)
        functions = {name: self._function(name) for name in self._spaces}
        start = functions.pop("start", self._problem.initial_displacement)
        history = {n: self.array(n) for n in self._places if n not in self._spaces}
        memory = replace(self._memory, arrays=history)
        problem = memory.before(self._problem, initial_displacement=start)
        problem = problem.as_solved_on(self._problem.solved_on)
        fields = object.__new__(Fields)
        vars(fields).update(functions, problem=problem)
        return fields

    def _function(self, name: str) -> GridFunction:
        """One of the functions."""
        function = GridFunction(self._spaces[name], name=name)
        function.vec.FV().NumPy()[:] = self.array(name)
        return function


def without(problem: Problem, names: Sequence[str]) -> Problem:
    """A solved problem without some of the data that the steps before have left."""
    other = problem.continued(**dict.fromkeys(names))
    return other.as_solved_on(problem.solved_on)
