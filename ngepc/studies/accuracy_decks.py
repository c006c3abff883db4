"""The problems of the study ``accuracy`` as input files of CalculiX."""

from __future__ import annotations

import numpy as np
from ngsolve import Mesh

from ngepc.studies import calculix
from ngepc.studies.accuracy_cases import Case, Rigid
from ngepc.studies.calculix import Deck, QuadraticMesh


def deck_of(case: Case, mesh: Mesh) -> Deck:
    """A case as an input file of CalculiX with quadratic elements."""
    body = QuadraticMesh(mesh)
    plane = mesh.dim == 2
    deck = Deck()
    deck.mesh(body.points, body.elements, calculix.KINDS[body.shape], "BODY")
    m = case.metal
    plastic = calculix.plastic_lines(m.yield_stress, m.modulus)
    deck.material("METAL", m.young, m.poisson, *plastic)
    deck.section("BODY", "METAL", plane)
    held = held_lines(case, body, deck)
    moved = []
    if "contact" in case.loads:
        moved = rigid_layer(case, body, deck)
    deck.add("*BOUNDARY", *[line for line, value in held if value == 0])
    if moved:
        deck.add(*moved[:-1])
    deck.add("*STEP,INC=1000", "*STATIC", "1.,1.")
    prescribed = [line for line, value in held if value != 0] + moved[-1:]
    if prescribed:
        deck.add("*BOUNDARY", *prescribed)
    loads = traction_lines(case, body)
    if loads:
        deck.add("*CLOAD", *loads)
    printed(case, body, deck)
    deck.add("*END STEP")
    return deck


def held_lines(case: Case, body: QuadraticMesh, deck: Deck) -> list[tuple[str, float]]:
    """Lines of *BOUNDARY with prescribed values; adds the node sets to the deck."""
    held = dict(case.loads.get("prescribed") or {})
    clamped = case.loads["clamped"]
    if clamped:
        held[clamped] = (0,) * body.points.shape[1]
    lines = []
    for number, (names, components) in enumerate(held.items()):
        nodes = [body.nodes_on(name) for name in names.split("|")]
        deck.node_set(f"HELD{number}", np.unique(np.concatenate(nodes)))
        for axis, value in enumerate(components, 1):
            if value is not None:
                line = f"HELD{number},{axis},{axis},{value:.12g}"
                lines.append((line, value))
    return lines


def traction_lines(case: Case, body: QuadraticMesh) -> list[str]:
    """Nodal forces of constant tractions on straight quadratic edges: 1/6, 4/6, 1/6."""
    lines = []
    for name, traction in case.loads.get("traction", {}).items():
        loaded = [(axis, value) for axis, value in enumerate(traction, 1) if value]
        for a, b, middle, length in body.edges_on(name):
            for node, share in ((a, 1 / 6), (b, 1 / 6), (middle, 4 / 6)):
                for axis, value in loaded:
                    force = share * length * value
                    lines.append(f"{node + 1},{axis},{force:.12g}")
    return lines


def rigid_layer(case: Case, body: QuadraticMesh, deck: Deck) -> list[str]:
    """Add a layer of stiff elements with the shape of the rigid surface, and contact with it.

    Returns lines of *BOUNDARY; the last one is that of the step.
    """
    rigid = case.rigid
    plane = body.points.shape[1] == 2
    below, corners = curve_of(rigid) if plane else surface_of(rigid)
    above = below.copy()
    above[:, -1] = below[:, -1].max() + 0.1 * (rigid.span[1] - rigid.span[0])
    layers = [corners, corners + len(below)]
    if plane:
        layers[1] = layers[1][:, ::-1]  # around the element

    first = deck.elements
    points = np.vstack([below, above])
    before = deck.mesh(points, np.hstack(layers), "CPE4" if plane else "C3D8", "RIGID")
    deck.node_set("RIGIDNODES", np.arange(before, before + len(points)))
    deck.surface("MASTER", [(first + k, 0) for k in range(len(corners))])
    near = [
        (element, face)
        for element, face in body.faces_on(case.loads["contact"])
        if within_reach(rigid, body, element, face)
    ]
    deck.surface("SLAVE", near)
    young = case.metal.young
    deck.material("STIFF", 10 * young, case.metal.poisson)
    deck.section("RIGID", "STIFF", plane)
    deck.add("*SURFACE INTERACTION,NAME=TOUCH")
    deck.add(
        "*SURFACE BEHAVIOR,PRESSURE-OVERCLOSURE=LINEAR",
        f"{rigid.stiffness * young:.12g}",
    )
    deck.add("*CONTACT PAIR,INTERACTION=TOUCH,TYPE=SURFACE TO SURFACE", "SLAVE,MASTER")
    up = 2 if plane else 3
    return [f"RIGIDNODES,1,{up - 1},0.", f"RIGIDNODES,{up},{up},{-rigid.depth:.12g}"]


def curve_of(rigid: Rigid) -> tuple[np.ndarray, np.ndarray]:
    """Points of a disc, and the two ends of each segment of its outline."""
    s = np.linspace(*rigid.span, rigid.cells + 1)
    points = np.column_stack([s, rigid.height((s - rigid.axis) ** 2)])
    number = np.arange(rigid.cells)
    return points, np.column_stack([number, number + 1])


def surface_of(rigid: Rigid) -> tuple[np.ndarray, np.ndarray]:
    """Points of a sphere, and the four corners of each face of its surface."""
    s = np.linspace(*rigid.span, rigid.cells + 1)
    X, Y = np.meshgrid(s, s, indexing="ij")
    points = np.stack([X, Y, rigid.height(X**2 + Y**2)], axis=-1).reshape(-1, 3)
    corner = np.arange((rigid.cells + 1) ** 2).reshape(rigid.cells + 1, -1)
    quads = [corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]]
    return points, np.stack(quads, axis=-1).reshape(-1, 4)


def within_reach(rigid: Rigid, body: QuadraticMesh, element: int, face: int) -> bool:
    """Whether a face lies below the rigid surface."""
    corners = body.corners[element, list(calculix.FACES[body.shape][face])]
    return bool(body.points[corners, :-1].max() < rigid.reach)


def printed(case: Case, body: QuadraticMesh, deck: Deck) -> None:
    """Lines of an input file that print the number of a case."""
    kind, where, _, _ = case.printed
    if kind == "force":
        deck.node_set("ASKED", body.nodes_on(where))
        deck.add("*NODE PRINT,NSET=ASKED,TOTALS=ONLY", "RF")
        return
    away = np.linalg.norm(body.points - np.array(where), axis=1)
    deck.node_set("ASKED", np.array([away.argmin()]))
    deck.add("*NODE PRINT,NSET=ASKED", "U")
