"""Several cores for a solve: threads of Python, and those of NGSolve where cores are free.

NumPy, SciPy and NGSolve release Python's lock while they compute, so that threads of Python do the
parts of an assembly or a product at the same time (PyAMG's compiled loops keep it).  They exist as
long as the outermost function that is decorated with ``crew()``: none is left when it returns.
What is computed does not depend on their number: parts are the same, and are added up in the same
order.

NGSolve's own threads wait busily for each other.  Beside other work that takes several times as
long as one thread, so that they are used only if threads of Python have just had their cores for
themselves.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from functools import cached_property
from multiprocessing import parent_process
from queue import SimpleQueue
from typing import Generic, TypeVar

from ngsolve import TaskManager
from pyngcore import GetNumThreads

MOST = 4
"""Largest number of threads: Python's own work between compiled loops is done by one at a time."""

AHEAD = 4
"""Parts that a thread computes before the first of them is used: memory is that of a few."""

FREE = 0.75
"""Part of a loop's time that helping threads must have computed for cores to count as free."""

SHORT = 1e-3
"""Shorter loops say nothing of free cores (s)."""

LAUNCHED = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "PMIX_RANK")
"""Environment of processes that MPI has started."""

Part = TypeVar("Part")
Value = TypeVar("Value")


def usable_threads() -> int:
    """The number of threads for a solve, at most ``MOST``.

    It is that of NGSolve (``NGS_NUM_THREADS``, ``SetNumThreads``), but not above that of the cores,
    and 1 in workers of a pool, in processes of MPI, and in other threads than the main one.
    """
    alone = threading.current_thread() is threading.main_thread()
    shared = parent_process() is not None or any(
        name in os.environ for name in LAUNCHED
    )
    if shared or not alone:
        return 1
    with TaskManager():
        threads = GetNumThreads()
    return min(MOST, threads, cores())


def cores() -> int:
    """The number of cores that this process may use."""
    if sys.platform == "linux":
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class _Loop(Generic[Part, Value]):
    """The parts of a loop, each taken by the thread that is free, and their values in order."""

    def __init__(
        self, function: Callable[[Part], Value], parts: Sequence[Part]
    ) -> None:
        self._function = function
        self._parts = parts
        self._numbers = iter(
            range(len(parts))
        )  # next() is done by one thread at a time
        self._values: dict[int, Value] = {}
        self._failures: list[BaseException] = []
        self._room = threading.Semaphore(AHEAD)
        self._arrived: SimpleQueue[None] = SimpleQueue()
        self._left: SimpleQueue[None] = SimpleQueue()
        self._busy: dict[int, float] = {}

    @property
    def busy(self) -> float:
        """The processor time of the helpers (s)."""
        return sum(self._busy.values())

    def help(self) -> None:
        """Compute parts until none is left."""
        begin = time.thread_time()
        try:
            for number in self._numbers:
                value = self._function(self._parts[number])
                self._busy[threading.get_ident()] = time.thread_time() - begin
                self._values[number] = value
                self._arrived.put(None)
                self._room.acquire()
        except BaseException as failure:
            self._failures.append(failure)
        self._arrived.put(None)
        self._left.put(None)

    def values(self) -> Iterator[Value]:
        """The values in order, computed here as far as helpers have not begun with them."""
        for number in range(len(self._parts)):
            while number not in self._values and not self._failures:
                mine = next(self._numbers, None)
                if mine is None:
                    self._arrived.get()
                else:
                    self._values[mine] = self._function(self._parts[mine])
            if self._failures:
                raise self._failures[0]
            self._room.release()
            yield self._values.pop(number)

    def stop(self) -> None:
        """Leave the parts that nobody has begun with."""
        deque(self._numbers, maxlen=0)
        self._room.release(len(self._parts) + 1)

    def wait(self, helpers: int) -> None:
        """Return when so many helpers have left."""
        for _ in range(helpers):
            self._left.get()


class Crew:
    """The threads of a solve; ``size`` is their number, by default what is ``usable_threads``."""

    def __init__(self, size: int | None = None) -> None:
        self._given = size
        self._process = os.getpid()
        self._share = 0.0  # of the last loop's time that helping threads have computed
        self._threads: list[threading.Thread] = []
        self.works = False  # on a loop: one that begins inside it has no threads

    @cached_property
    def size(self) -> int:
        """The number of threads, 1 in a process that was forked meanwhile."""
        return usable_threads() if self._given is None else self._given

    @cached_property
    def _tasks(self) -> SimpleQueue[Callable[[], None] | None]:
        """What helping threads take tasks from; the threads begin when it is made."""
        tasks: SimpleQueue[Callable[[], None] | None] = SimpleQueue()
        for thread in range(1, self.size):
            name = f"ngepc-{thread}"
            self._threads.append(
                threading.Thread(target=_work, args=(tasks,), name=name)
            )
            self._threads[-1].start()
        return tasks

    @property
    def helps(self) -> bool:
        """Whether there are several threads; a process forked meanwhile has none."""
        return self.size > 1 and self._process == os.getpid()

    @property
    def has_free_cores(self) -> bool:
        """Whether the threads had their cores for themselves in the last loop."""
        return self._share >= FREE and self.helps

    def in_order(
        self, function: Callable[[Part], Value], parts: Sequence[Part]
    ) -> Iterator[Value]:
        """The function of each part, in order; a few parts are computed ahead.

        The caller's thread computes, too: a thread that only waits and is woken for each value
        costs more than many a part.  Nobody waits for the others to leave a loop that is complete.
        """
        loop = _Loop(function, parts)
        helpers = min(self.size, len(parts)) - 1
        complete = False
        self.works = True
        begin = time.perf_counter()
        for _ in range(helpers):
            self._tasks.put(loop.help)
        try:
            yield from loop.values()
            complete = True
        finally:
            self.works = False
            wall = time.perf_counter() - begin
            loop.stop()
            if not complete:
                loop.wait(helpers)
        if wall > SHORT:
            self._share = loop.busy / (wall * helpers)

    def close(self) -> None:
        """End the threads."""
        if self._process != os.getpid():
            return
        for _ in self._threads:
            self._tasks.put(None)
        for thread in self._threads:
            thread.join()


def _work(tasks: SimpleQueue[Callable[[], None] | None]) -> None:
    """Do tasks until there is a None."""
    while (task := tasks.get()) is not None:
        task()


_CREW: ContextVar[Crew | None] = ContextVar("crew", default=None)


@contextmanager
def crew(size: int | None = None) -> Iterator[Crew]:
    """Threads for what is computed inside, ended afterwards; those of an outer crew if any.

    Also a decorator, ``@crew()``.
    """
    outer = _CREW.get()
    if outer is not None:
        yield outer
        return
    own = Crew(size)
    token = _CREW.set(own)
    try:
        yield own
    finally:
        _CREW.reset(token)
        own.close()


def in_order(
    function: Callable[[Part], Value], parts: Sequence[Part]
) -> Iterator[Value]:
    """The function of each part, in order, by the threads of the crew if there is one."""
    threads = _CREW.get()
    if threads is None or len(parts) < 2 or threads.works or not threads.helps:
        return map(function, parts)
    return threads.in_order(function, parts)


def threads_of_ngsolve() -> AbstractContextManager:
    """NGSolve's threads for what is computed inside, if cores are free."""
    threads = _CREW.get()
    busy = threads is None or not threads.has_free_cores
    return nullcontext() if busy else TaskManager()
