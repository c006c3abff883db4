"""How runs and searches end: names whose values are sentences for the user."""

from enum import Enum


class Labelled(Enum):
    """A status; its value is the sentence for the user."""

    def __str__(self) -> str:
        return self.label

    @property
    def label(self) -> str:
        """Short name for tables and files: 'converged', 'mesh_limit', ..."""
        return self.name.lower()
