"""Whether another mesh fits into a time limit."""

import time


class Clock:
    """The time that meshes take, and whether another one fits into ``seconds``."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds
        self.begin = time.perf_counter()
        self.spent = 0.0
        self.expected = 0.0
        self._nodes = 0

    def after(self, nodes: int) -> None:
        """Expect the next mesh after one with these nodes: it grows as much, and so does its time.

        After the first mesh the next one is expected to take as long.
        """
        spent = time.perf_counter() - self.begin
        growth = nodes / self._nodes if self._nodes else 1.0
        self.expected = growth * (spent - self.spent)
        self.spent = spent
        self._nodes = nodes

    @property
    def too_late(self) -> bool:
        """Whether the next mesh is expected to end after ``seconds``."""
        return self.spent + self.expected > self.seconds

    @property
    def ending(self) -> str:
        """Why there is no next mesh."""
        return (
            "No new mesh is started: it would end after about "
            f"{self.spent + self.expected:.2g} s, seconds={self.seconds:g}."
        )
