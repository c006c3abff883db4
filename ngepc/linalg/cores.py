"""Several cores for a solve: threads of Python, and those of NGSolve where cores are free.

NumPy, SciPy, PyAMG and NGSolve release Python's lock while they compute, so that threads of Python
do the parts of an assembly or a sweep at the same time.  They exist as long as the outermost
function that is decorated with ``crew()``: none is left when it returns.  What is computed does
not depend on their number: parts are the same, and are added up in the same order.

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
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from functools import cached_property
from multiprocessing import parent_process
from typing import TypeVar

from ngsolve import TaskManager
from pyngcore import GetNumThreads

MOST = 4
"""Largest number of threads: Python's own work between compiled loops is done by one at a time."""

SHARES = 8
"""Portions of a loop for each thread, so that all end at about the same time."""

FREE = 0.75
"""Part of the time that threads must have computed for cores to count as free."""

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


class Crew:
    """The threads of a solve; ``size`` is their number, by default what is ``usable_threads``."""

    def __init__(self, size: int | None = None) -> None:
        self._given = size
        self._process = os.getpid()
        self._share = 0.0  # of their time that threads have computed in the last loop

    @cached_property
    def size(self) -> int:
        """The number of threads, 1 in a process that was forked meanwhile."""
        return usable_threads() if self._given is None else self._given

    @cached_property
    def _pool(self) -> ThreadPoolExecutor:
        return ThreadPoolExecutor(self.size, thread_name_prefix="ngepc")

    @property
    def helps(self) -> bool:
        """Whether there are several threads; a process forked meanwhile has none."""
        return self.size > 1 and self._process == os.getpid()

    @property
    def has_free_cores(self) -> bool:
        """Whether the threads had their cores for themselves in the last loop."""
        return self._share >= FREE and self.helps

    def in_portions(
        self, function: Callable[[Part], Value], parts: Sequence[Part]
    ) -> Iterator[Value]:
        """The function of each part, in order; a few portions are computed ahead."""
        size = max(1, len(parts) // (SHARES * self.size))
        portions = [parts[k : k + size] for k in range(0, len(parts), size)]
        busy: list[float] = []

        def work(portion: list[Part]) -> list[Value]:
            """The values of a portion; the processor time is recorded."""
            begin = time.thread_time()
            values = [function(part) for part in portion]
            busy.append(time.thread_time() - begin)
            return values

        begin = time.perf_counter()
        ahead = deque()
        for portion in portions:
            ahead.append(self._pool.submit(work, portion))
            if len(ahead) > 2 * self.size:
                yield from ahead.popleft().result()
        while ahead:
            yield from ahead.popleft().result()
        wall = time.perf_counter() - begin
        if wall > SHORT:
            self._share = sum(busy) / (wall * self.size)

    def close(self) -> None:
        """End the threads."""
        if "_pool" in vars(self) and self._process == os.getpid():
            self._pool.shutdown()


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


def in_portions(
    function: Callable[[Part], Value], parts: Sequence[Part]
) -> Iterator[Value]:
    """The function of each part, in order, by the threads of the crew if there is one."""
    threads = _CREW.get()
    if threads is None or len(parts) < 2 or not threads.helps:
        return map(function, parts)
    return threads.in_portions(function, parts)


def threads_of_ngsolve() -> AbstractContextManager:
    """NGSolve's threads for what is computed inside, if cores are free."""
    threads = _CREW.get()
    busy = threads is None or not threads.has_free_cores
    return nullcontext() if busy else TaskManager()
