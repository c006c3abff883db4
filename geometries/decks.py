"""Decks of Abaqus and CalculiX: nodes, elements, sections, node sets and surfaces.

What else a deck says, materials, steps, supports and loads, is not read.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ngepc.checks.sentences import counted

from .cards import Card, cards_of
from .cells import FACETS, SHAPES

SOLIDS = {
    4: "tetra",
    5: "pyramid",
    6: "wedge",
    8: "hexahedron",
    10: "tetra10",
    13: "pyramid13",
    15: "wedge15",
    20: "hexahedron20",
}
PLANES = {3: "triangle", 4: "quad", 6: "triangle6", 8: "quad8"}

_TYPES = (
    (re.compile(r"(?:D|F|A)?C?3D(\d+)"), SOLIDS),
    (re.compile(r"(?:CPS|CPE|CAX|DC2D|DCAX|STRI|M3D|R3D|S)(\d)"), PLANES),
)
"""Families of element types with the number of nodes in the name; others are no bodies."""

GENERATED = ("NGEN", "NFILL", "NCOPY", "NMAP", "ELGEN", "ELCOPY", "SYSTEM")
"""Keywords that make nodes and elements, or turn coordinates."""

SIDES = {
    (2, 3): ((0, 1), (1, 2), (2, 0)),
    (2, 4): ((0, 1), (1, 2), (2, 3), (3, 0)),
    (3, 4): ((0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0)),
    (3, 5): FACETS[3, 5],
    (3, 6): ((0, 1, 2), (3, 5, 4), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
    (3, 8): (
        (0, 1, 2, 3),
        (4, 7, 6, 5),
        (0, 4, 5, 1),
        (1, 5, 6, 2),
        (2, 6, 7, 3),
        (3, 7, 4, 0),
    ),
}
"""(dimension, corners) -> corners of the sides S1, S2, ... of an element."""


class Cells(NamedTuple):
    """Cells of one shape, by the name that meshio has for it."""

    type: str
    data: np.ndarray


@dataclass
class Deck:
    """What a deck says of its mesh, with the attributes of a ``meshio.Mesh``."""

    points: np.ndarray
    cells: list[Cells]
    cell_sets: dict[str, list[np.ndarray]]
    point_sets: dict[str, np.ndarray]
    cell_data: dict = field(default_factory=dict)
    field_data: dict = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)  # what a user must know


def read_deck(path: Path) -> Deck:
    """The mesh of a deck, with the files that it includes.

    Elements belong to the set of their ``*SOLID SECTION``, or that of their ``*ELEMENT`` card.
    Surfaces become cells of their own.

    Raises
    ------
    OSError
        If a file is missing.
    ValueError
        If the deck is damaged, or is made of several parts.
    """
    return _Reader(list(cards_of(path))).deck()


class _Elements(NamedTuple):
    """The elements of one card."""

    type: str
    name: str
    numbers: np.ndarray
    nodes: np.ndarray


class _Reader:
    """What the cards of one deck say of its mesh."""

    def __init__(self, cards: list[Card]) -> None:
        parts = [card for card in cards if card.keyword == "INSTANCE"]
        if len(parts) > 1:
            raise ValueError(
                f"the deck has {len(parts)} instances of parts: a deck without parts and "
                "assemblies is needed"
            )
        self.cards = cards
        self.spelled: dict[str, str] = {}
        self.node_sets: dict[str, list[int]] = {}
        self.element_sets: dict[str, list[int]] = {}
        self.coordinates: dict[int, list[float]] = {}
        self.elements: list[_Elements] = []
        self.surfaces: dict[str, list[tuple[str, str]]] = {}
        self.sections: list[str] = []
        self.notes: list[str] = []
        self.strange: set[str] = set()  # types of elements that are no bodies
        for card in cards:
            if card.keyword in GENERATED:
                raise ValueError(
                    f"*{card.keyword}: a deck with all nodes and elements, and Cartesian "
                    "coordinates, is needed"
                )
            read = getattr(self, "_" + card.keyword.replace(" ", "_").lower(), None)
            if read is not None:
                read(card)

    def _key(self, name: str) -> str:
        """A name in capitals, remembered as it was spelled first."""
        name = name.strip("\"'")
        self.spelled.setdefault(name.upper(), name)
        return name.upper()

    def _instance(self, card: Card) -> None:
        moved = [row for row in card.rows if any(float(entry or 0) for entry in row)]
        if moved:
            self.notes.append(
                f"has an instance that is moved by {', '.join(moved[0])}: the mesh is that of its "
                "part, which is not moved"
            )

    def _node(self, card: Card) -> None:
        system = card.parameters.get("SYSTEM", "R")
        if system.upper() != "R":
            raise ValueError(
                f"*NODE, SYSTEM={system}: Cartesian coordinates are needed"
            )
        numbers = []
        for row in card.rows:
            coordinates = [float(entry or 0) for entry in row[1:4]]
            numbers.append(int(row[0]))
            self.coordinates[numbers[-1]] = coordinates + [0.0] * (3 - len(coordinates))
        if card.parameters.get("NSET"):
            key = self._key(card.parameters["NSET"])
            self.node_sets.setdefault(key, []).extend(numbers)

    def _element(self, card: Card) -> None:
        kind = card.parameters.get("TYPE", "").upper()
        found = _shape_of(kind)
        if found is None:
            self.strange.add(kind or "none")
            return
        shape, count = found
        table = _table(card, count + 1)
        name = card.parameters.get("ELSET", "")
        if name:
            key = self._key(name)
            name = self.spelled[key]
            self.element_sets.setdefault(key, []).extend(table[:, 0].tolist())
        self.elements.append(_Elements(shape, name, table[:, 0], table[:, 1:]))

    def _nset(self, card: Card) -> None:
        key = self._key(card.parameters.get("NSET", ""))
        chosen = self.node_sets.setdefault(key, [])
        elements = card.parameters.get("ELSET")
        if elements:
            wanted = self.element_sets.get(elements.upper(), [])
            for block in self.elements:
                chosen.extend(block.nodes[np.isin(block.numbers, wanted)].ravel())
        chosen.extend(self._members(card, self.node_sets))

    def _elset(self, card: Card) -> None:
        key = self._key(card.parameters.get("ELSET", ""))
        members = self._members(card, self.element_sets)
        self.element_sets.setdefault(key, []).extend(members)

    def _members(self, card: Card, known: dict[str, list[int]]) -> list[int]:
        """The numbers that the rows of a set give, by themselves, by ranges and by names."""
        members: list[int] = []
        for row in card.rows:
            entries = [entry for entry in row if entry]
            if "GENERATE" in card.parameters:
                first, last, *step = map(int, entries)
                members += range(first, last + 1, *step)
                continue
            for entry in entries:
                number = entry.lstrip("+-").isdigit()
                members += [int(entry)] if number else known.get(entry.upper(), [])
        return members

    def _surface(self, card: Card) -> None:
        key = self._key(card.parameters.get("NAME", ""))
        if card.parameters.get("TYPE", "ELEMENT").upper() == "NODE":
            chosen = self.node_sets.setdefault(key, [])
            chosen.extend(self._members(card, self.node_sets))
            return
        sides = self.surfaces.setdefault(key, [])
        sides.extend((row[0], row[1].upper()) for row in card.rows if len(row) > 1)

    def _solid_section(self, card: Card) -> None:
        name = card.parameters.get("ELSET")
        if name and name.upper() not in self.sections:
            self.sections.append(self._key(name))

    def deck(self) -> Deck:
        """The mesh, with nodes numbered from zero."""
        numbers = np.array(sorted(self.coordinates), dtype=int)
        points = np.array([self.coordinates[k] for k in numbers.tolist()])
        cells = []
        names = []
        for block in self.elements:
            for name, chosen in self._by_section(block):
                nodes = positions(numbers, block.nodes[chosen], block.type)
                cells.append(Cells(block.type, nodes))
                names.append(name)
        for name, shape, corners in self._surface_cells():
            cells.append(Cells(shape, positions(numbers, corners, shape)))
            names.append(name)
        nothing = np.zeros(0, dtype=int)
        sets: dict[str, list[np.ndarray]] = {}
        for at, name in enumerate(names):
            if name:
                entry = sets.setdefault(name, [nothing] * len(cells))
                entry[at] = np.arange(len(cells[at].data))
        node_sets = {}
        for key, members in self.node_sets.items():
            chosen = np.isin(numbers, np.array(members, dtype=int))
            node_sets[self.spelled[key]] = np.flatnonzero(chosen)
        if self.strange:
            self.notes.append(
                f"has elements of type {', '.join(sorted(self.strange))}, which are not those of "
                "bodies: they are left out"
            )
        return Deck(points.reshape(-1, 3), cells, sets, node_sets, notes=self.notes)

    def _by_section(self, block: _Elements) -> Iterator[tuple[str, np.ndarray]]:
        """The elements of a card by the section that they belong to, else by its own set."""
        rest = np.ones(len(block.numbers), dtype=bool)
        for key in self.sections:
            inside = rest & np.isin(block.numbers, self.element_sets.get(key, []))
            if inside.any():
                yield self.spelled[key], inside
                rest &= ~inside
        if rest.any():
            yield block.name, rest

    def _surface_cells(self) -> Iterator[tuple[str, str, np.ndarray]]:
        """Name, shape and corners of the sides of each surface, the smallest surface first.

        A side that two surfaces have belongs to the smaller one.
        """
        found = {key: self._sides(rows) for key, rows in self.surfaces.items()}
        taken: set[tuple[int, ...]] = set()
        for key in sorted(found, key=lambda key: len(found[key])):
            own = {tuple(sorted(side)): side for side in found[key]}
            new = [side for corners, side in own.items() if corners not in taken]
            if len(new) < len(own):
                self.notes.append(
                    f"has {counted(len(own), 'side')} in the surface {self.spelled[key]!r}: "
                    f"{len(own) - len(new)} of them with the name of a smaller one"
                )
            taken.update(own)
            for count, shape in ((2, "line"), (3, "triangle"), (4, "quad")):
                alike = [side for side in new if len(side) == count]
                if alike:
                    yield self.spelled[key], shape, np.array(alike)

    def _sides(self, rows: Sequence[tuple[str, str]]) -> list[tuple[int, ...]]:
        """Node numbers at the corners of the sides that the rows of a surface name."""
        sides = []
        for chosen, label in rows:
            number = chosen.isdigit()
            wanted = [int(chosen)] if number else self.element_sets.get(chosen.upper())
            if not wanted or not re.fullmatch(r"S\d", label):
                continue
            for block in self.elements:
                N, corners = SHAPES[block.type.rstrip("0123456789")]
                if int(label[1]) > len(SIDES[N, corners]):
                    continue
                side = list(SIDES[N, corners][int(label[1]) - 1])
                inside = np.isin(block.numbers, wanted)
                sides += map(tuple, block.nodes[inside][:, side].tolist())
        return sides


def _table(card: Card, width: int) -> np.ndarray:
    """Element and node numbers; an element begins on a row of its own, what is over is ignored."""
    found = []
    current: list[int] = []
    for row in card.rows:
        current += [int(entry) for entry in row if entry]
        if len(current) >= width:
            found.append(current[:width])
            current = []
    if current:
        kind = card.parameters.get("TYPE")
        raise ValueError(
            f"*ELEMENT, TYPE={kind}: element {current[0]} has {len(current) - 1} nodes, "
            f"{width - 1} are needed"
        )
    return np.array(found, dtype=int).reshape(-1, width)


def _shape_of(kind: str) -> tuple[str, int] | None:
    """Shape and number of nodes of an element type, None for those that are no bodies."""
    for pattern, shapes in _TYPES:
        match = pattern.match(kind)
        if match and int(match.group(1)) in shapes:
            return shapes[int(match.group(1))], int(match.group(1))
    return None


def positions(numbers: np.ndarray, nodes: np.ndarray, shape: str) -> np.ndarray:
    """Positions of node numbers in a rising list; a ValueError for one that is not in it."""
    at = np.searchsorted(numbers, nodes)
    known = (
        numbers[np.minimum(at, len(numbers) - 1)] == nodes if len(numbers) else at < 0
    )
    if not known.all():
        first = int(nodes[~known][0])
        raise ValueError(f"{shape!r} cells have node {first}, which has no coordinates")
    return at
