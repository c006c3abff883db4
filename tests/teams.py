"""Processes without MPI: threads that take turns, with the calls of mpi4py that ``Team`` needs.

Only one of them runs at a time; it gives its turn away where it waits for the others.  Where all
that still run wait for each other, they raise ``Apart``.
"""

import copy
import sys
from collections import defaultdict
from contextlib import nullcontext
from functools import cached_property
from threading import Condition, Thread

import numpy as np

from ngepc.local.iterative import Iterative


class Apart(RuntimeError):
    """The processes no longer do the same."""


class Crew:
    """What the threads of one run share."""

    def __init__(self, size):
        self.size = size
        self.turn = Condition()
        self.rounds = defaultdict(dict)
        self.letters = defaultdict(list)
        self.running = size
        self.waiting = []
        self.apart = False

    def wait_until(self, ready):
        """Give the turn away until something is there; ``Apart`` if nobody can bring it."""
        self.waiting.append(ready)
        self.look()
        self.turn.notify_all()
        self.turn.wait_for(lambda: self.apart or ready())
        self.waiting.remove(ready)
        if not ready():
            raise Apart("a process waits for what no other one does")

    def look(self):
        """Notice that all processes that still run wait in vain."""
        in_vain = not any(ready() for ready in self.waiting)
        self.apart |= in_vain and len(self.waiting) == self.running

    def end(self, in_order):
        """One process has ended."""
        self.running -= 1
        self.apart |= not in_order
        self.look()
        self.turn.notify_all()


class Communicator:
    """One process of a crew."""

    def __init__(self, crew, rank):
        self._crew = crew
        self._number = 0
        self.size = crew.size
        self.rank = rank

    def allgather(self, value):
        round_ = self._crew.rounds[self._number]
        self._number += 1
        round_[self.rank] = copy.deepcopy(value)
        self._crew.wait_until(lambda: len(round_) == self.size)
        return [copy.deepcopy(round_[rank]) for rank in range(self.size)]

    def allreduce(self, value):
        values = self.allgather(value)
        return sum(values[1:], values[0])

    def alltoall(self, values):
        return [sent[self.rank] for sent in self.allgather(values)]

    def scatter(self, values, root=0):
        return self.allgather(values)[root][self.rank]

    def Isend(self, array, rank):
        self._crew.letters[self.rank, rank].append(array.copy())
        return Done()

    def Irecv(self, array, rank):
        return Letter(self._crew, self._crew.letters[rank, self.rank], array)


class Done:
    def Wait(self):
        pass


class Letter:
    def __init__(self, crew, letters, array):
        self.crew = crew
        self.letters = letters
        self.array = array

    def Wait(self):
        self.crew.wait_until(lambda: self.letters)
        np.copyto(self.array, self.letters.pop(0))


def without_locks():
    """Before Python 3.12 one lock guards a cached property of all objects of a class."""
    modules = [m for name, m in list(sys.modules.items()) if name.startswith("ngepc")]
    classes = (c for m in modules for c in vars(m).values() if isinstance(c, type))
    for kind in classes:
        for value in vars(kind).values():
            if isinstance(value, cached_property):
                value.lock = nullcontext()


def run(size, work):
    """What ``work(comm)`` returns on each of several processes; the first exception is raised."""
    without_locks()
    crew = Crew(size)
    found = {}
    errors = []

    def process(rank):
        with crew.turn:
            try:
                found[rank] = work(Communicator(crew, rank))
            except Exception as error:  # raised again by the main thread
                errors.append(error)
            crew.end(in_order=rank in found)

    threads = [Thread(target=process, args=(rank,)) for rank in range(size)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    others = [error for error in errors if not isinstance(error, Apart)]
    if errors:
        raise (others or errors)[0]
    return [found[rank] for rank in range(size)]


class Jacobi(Iterative):
    """Conjugate gradients with the inverse of the diagonal, for small bodies in parts."""

    def preconditioner(self, pattern, body):
        return SharedDiagonal(body)


class SharedDiagonal:
    """The diagonal of the sum over processes."""

    def __init__(self, body):
        self._processes = body.contact.processes
        self._shape = body.free.shape

    def coarsen(self, matrix):
        pass

    def update(self, pinned):
        own = pinned.diagonal().reshape(self._shape)
        diagonal = self._processes.summed(own).ravel()
        return lambda residual: residual / diagonal
