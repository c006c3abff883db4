"""Files of other programs, made for these tests: what comes in, what is said, what is refused."""

import shutil
import warnings
from pathlib import Path

import meshio
import numpy as np
import pytest
from bodies import STEEL
from ngsolve import Integrate

from ngepc import Problem, semismooth_newton
from ngepc.geometries import imported

FILES = Path(__file__).parent / "files"

PLAIN = ("bottom", "free", "top")
GROUPLESS = r"has no groups: its boundary is called 'boundary'"

EXPECTED = {
    # dimension, elements, volume, names of boundaries, of materials, what is said
    "triangles_2.2.msh": (2, 14, 1.0, PLAIN, "body", None),
    "triangles_order_2.msh": (2, 14, 1.0, PLAIN, "body", None),
    "quadrilaterals_4.1.msh": (2, 22, 1.0, PLAIN, "body", None),
    "tetrahedra_4.1.msh": (3, 24, 1.0, PLAIN, "body", None),
    "tetrahedra_order_2.msh": (3, 24, 1.0, PLAIN, "body", None),
    "hexahedra_order_2.msh": (3, 8, 1.0, PLAIN, "body", None),
    "prisms.msh": (3, 8, 1.0, PLAIN, "body", None),
    "prism_and_tetrahedron.msh": (3, 2, 2 / 3, ("bottom", "free"), "body", None),
    "pyramids.msh": (
        3,
        16,
        5 / 3,
        ("bottom", "free", "slope"),
        "body",
        "has pyramids: all cells are split",
    ),
    "without_groups_2.2.msh": (2, 14, 1.0, ("boundary",), "body", GROUPLESS),
    "without_groups_4.1.msh": (3, 24, 1.0, ("boundary",), "body", GROUPLESS),
    "some_groups.msh": (2, 14, 1.0, ("free", "group 2", "top"), "body", None),
    "numbered_groups.msh": (
        3,
        24,
        1.0,
        ("free", "group 3", "group 4"),
        "group 7",
        None,
    ),
    "rigid_plane.msh": (
        3,
        24,
        1.0,
        PLAIN,
        "body",
        "has 26 facets of 'floor' that no element of the body has",
    ),
    "node_sets.inp": (3, 2, 2.0, ("Fixed", "Loaded", "free"), "Eall", None),
    "surfaces.inp": (
        3,
        2,
        2.0,
        ("Bottom", "Front", "FrontAndBack", "Top", "free"),
        "Lower Upper",
        "has 4 sides in the surface 'FrontAndBack': 2 of them with the name of a smaller one",
    ),
    "plane.inp": (2, 3, 2.0, ("Held", "Pressed", "free"), "Plate", None),
    "bulk.inp": (3, 1, 1 / 6, ("free",), "Bulk", None),
    "with_include.inp": (3, 1, 1 / 6, ("Floor", "free"), "Bulk", None),
    "squares.su2": (2, 3, 2.0, ("free", "group 1", "group 2"), "body", None),
    "tetrahedra.mesh": (3, 24, 1.0, ("free", "group 2", "group 3"), "group 1", None),
    "tetrahedra.bdf": (3, 24, 1.0, ("boundary",), "body", GROUPLESS),
    "tetrahedra.vtk": (3, 24, 1.0, ("boundary",), "body", GROUPLESS),
    "tetrahedra.vtu": (3, 24, 1.0, ("boundary",), "body", GROUPLESS),
}


def quietly(file):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return imported.read(FILES / file)


def test_every_file_is_expected():
    assert {path.name for path in FILES.iterdir()} == set(EXPECTED)


@pytest.mark.parametrize("file", EXPECTED)
def test_files_come_in_with_their_names(file):
    N, elements, volume, boundaries, materials, said = EXPECTED[file]
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        mesh = imported.read(FILES / file)
    assert (mesh.dim, mesh.ne) == (N, elements)
    assert Integrate(1, mesh) == pytest.approx(volume, rel=1e-6)
    assert tuple(sorted(set(mesh.GetBoundaries()))) == boundaries
    assert " ".join(sorted(set(mesh.GetMaterials()))) == materials
    texts = " ".join(str(one.message) for one in told)
    assert (said in texts) if said else not texts


@pytest.mark.parametrize("file", sorted({*EXPECTED} - {"bulk.inp", "with_include.inp"}))
def test_files_can_be_solved(file):
    """Held at one end, pressed at the other: it converges and yields.

    A single tetrahedron, the deck with the include, has no facet whose corners are all free.
    """
    mesh = quietly(file)
    x = np.asarray(mesh.ngmesh.Coordinates())[:, mesh.dim - 1]
    low, high = x.min(), x.max()
    mesh = imported.name(mesh, "low", lambda *c: c[-1] <= low + 1e-9)
    across = [0.0] * mesh.dim
    across[-1] = 1.0
    mesh = imported.name(mesh, "high", imported.Facing(across, 80))
    problem = Problem(mesh, STEEL, "low", contact="high", gap=-0.01 * (high - low))
    result = semismooth_newton(problem).raise_for_status()
    assert result.contact_force > 0
    assert Integrate(result.equivalent_plastic_strain, mesh) > 0


def test_the_same_column_as_a_deck_and_as_gmsh_has_it():
    """C3D8 in a deck, and the same hexahedra in a file of gmsh, give the same digits."""
    deck = quietly("node_sets.inp")
    points = [(x, y, z) for z in range(3) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))]
    cells = np.array([range(8), range(4, 12)])
    sides = [np.array([range(4)]), np.array([range(8, 12)])]
    blocks = [("hexahedron", cells), *(("quad", side) for side in sides)]
    sets = {
        name: [[0] if k == number else [] for k in range(3)]
        for number, name in ((1, "Fixed"), (2, "Loaded"))
    }
    plain = imported.mesh(meshio.Mesh(np.array(points, float), blocks, cell_sets=sets))
    given = {"clamped": "Fixed", "contact": "Loaded", "gap": -0.02}
    forces = [
        semismooth_newton(Problem(mesh, STEEL, **given)).contact_force
        for mesh in (deck, plain)
    ]
    assert forces[0] == pytest.approx(forces[1], rel=1e-12)


# What is refused


def column(**changes):
    """Two hexahedra, one on the other, with the square between them and the one below."""
    points = [(x, y, z) for z in range(3) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))]
    given = {
        "hexahedron": np.array([range(8), range(4, 12)]),
        "quad": np.array([(0, 3, 2, 1)]),
    }
    given |= changes
    sets = {"low": [[] for _ in given]}
    sets["low"][1] = list(range(len(given["quad"])))
    return meshio.Mesh(np.array(points, float), list(given.items()), cell_sets=sets)


REFUSED = {
    "a facet twice": (
        lambda: column(quad=np.array([(0, 3, 2, 1), (1, 2, 3, 0)])),
        r"1 facet twice, in low, for example that of the nodes \[0, 1, 2, 3\]",
    ),
    "a cell twice": (
        lambda: column(hexahedron=np.array([range(8)] * 2)),
        r"1 cells twice",
    ),
    "a node that is not there": (
        lambda: column(hexahedron=np.array([range(5, 13)])),
        r"'hexahedron' cells with node 12: 0 to 11 are needed",
    ),
    "a negative node": (
        lambda: column(quad=np.array([(0, 3, 2, -1)])),
        r"'quad' cells with node -1",
    ),
    "a corner twice": (
        lambda: column(hexahedron=np.array([[0, 1, 2, 3, 4, 4, 6, 7]])),
        r"1 of 1 'hexahedron' cells with a corner twice",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_damaged_meshes_are_refused_by_name(name):
    make, message = REFUSED[name]
    with pytest.raises(ValueError, match=message):
        imported.mesh(make())


def test_points_and_sets_that_are_damaged_are_refused():
    source = column()
    source.points[3, 0] = np.nan
    with pytest.raises(ValueError, match="points that are NaN or infinite"):
        imported.mesh(source)
    source = column()
    source.cell_sets["low"][1] = [4]
    with pytest.raises(ValueError, match=r"cell_sets\['low'\] has cells up to 4 of 1"):
        imported.mesh(source)
    source = column()
    source.point_sets = {"high": np.array([4, 5, 77])}
    with pytest.raises(ValueError, match=r"point_sets\['high'\] has point 77: 0 to 11"):
        imported.mesh(source)


def test_facets_of_nothing_are_dropped_and_counted():
    """A meshed rigid plane used to end the process."""
    points = np.vstack([column().points, [(5, 5, 5), (6, 5, 5), (5, 6, 5), (6, 6, 5)]])
    quads = np.array([(0, 3, 2, 1), (12, 13, 15, 14), (0, 1, 6, 7)])
    source = column(quad=quads)
    source.points = points
    with pytest.warns(UserWarning, match="has 2 facets of 'low' that no element"):
        mesh = imported.mesh(source)
    assert len(list(mesh.Boundaries("low").Elements())) == 1

    source.cell_sets.clear()
    with pytest.warns(UserWarning, match="has 2 facets without a name that no element"):
        mesh = imported.mesh(source)
    assert set(mesh.GetBoundaries()) == {"boundary"}


def test_sets_of_points_that_overlap_are_told():
    source = column()
    sets = {"low": np.arange(4), "lower": np.arange(8)}
    del source.cells[1]
    source.cell_sets.clear()
    source.point_sets = sets
    with pytest.warns(
        UserWarning,
        match="5 facets in the set 'lower': 1 of them with another name, low",
    ):
        mesh = imported.mesh(source)
    count = {b: len(list(mesh.Boundaries(b).Elements())) for b in ("low", "lower")}
    assert count == {"low": 1, "lower": 4}


DAMAGED = {
    "empty.msh": "",
    "text.vtu": "this is no mesh",
    "cut.inp": "*NODE\n1, 0., 0.\n*ELEMENT, TYPE=CPS4\n1, 1, 1, 1\n",
    "nodes.inp": "*NODE\n1, 0., 0.\n*ELEMENT, TYPE=CPS3\n1, 1, 2, 3\n",
    "parts.inp": "*PART\n*END PART\n*INSTANCE\n*END INSTANCE\n*INSTANCE\n*END INSTANCE\n",
    "includes.inp": "*INCLUDE, INPUT=includes.inp\n",
    "copies.inp": "*NODE\n1, 0., 0.\n*ELEMENT, TYPE=CPS3\n1, 1, 2, 3\n*ELGEN\n1, 2, 1, 1\n",
    "turned.inp": "*NODE, SYSTEM=C\n1, 0., 0.\n*ELEMENT, TYPE=CPS3\n1, 1, 2, 3\n",
    "unknown.format": "1 2 3",
}


@pytest.mark.parametrize("file", DAMAGED)
def test_damaged_files_are_refused_with_their_names(file, tmp_path):
    """Where meshio ends Python there is an exception."""
    path = tmp_path / file
    path.write_text(DAMAGED[file])
    with pytest.raises(ValueError, match=rf"{path} cannot be read: \S"):
        imported.read(path)


SQUARE = "*NODE\n1, 0., 0.\n2, 1., 0.\n3, 1., 1.\n4, 0., 1.\n"
SQUARE += "*ELEMENT, TYPE=CPS4, ELSET=Sheet\n1, 1, 2, 3, 4\n"


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ("*ELEMENT, TYPE=SPRING1\n2, 1\n", "elements of type SPRING1, which are not"),
        (
            "*INSTANCE, NAME=One\n5., 0., 0.\n",
            "is moved by 5., 0., 0.: the mesh is that",
        ),
    ],
)
def test_what_a_deck_has_beside_its_mesh_is_told(more, said, tmp_path):
    path = tmp_path / "square.inp"
    path.write_text(SQUARE + more)
    with pytest.warns(UserWarning, match=said):
        assert imported.read(path).ne == 1


def test_names_and_words_of_decks_in_any_spelling(tmp_path):
    """Sets whose names differ in capitals alone are one; GENERATE may stand on a line below."""
    path = tmp_path / "square.inp"
    second = (
        "*NODE\n5, 2., 0.\n6, 2., 1.\n*ELEMENT, TYPE=CPS4, ELSET=SHEET\n2, 2, 5, 6, 3\n"
    )
    path.write_text(SQUARE + second + "*NSET, NSET=Held,\nGENERATE\n1, 4, 3\n")
    mesh = imported.read(path)
    assert (mesh.ne, mesh.GetMaterials()) == (2, ("Sheet",))
    assert sorted(set(mesh.GetBoundaries())) == ["Held", "free"]


def test_missing_files_and_bodies_are_named(tmp_path):
    with pytest.raises(FileNotFoundError, match="there is no such file"):
        imported.read(tmp_path / "part.msh")
    with pytest.raises(TypeError, match="the name of a file is needed"):
        imported.read(3)
    path = tmp_path / "beam.inp"
    path.write_text("*NODE\n1, 0., 0.\n2, 1., 0.\n*ELEMENT, TYPE=B31\n1, 1, 2\n")
    with pytest.raises(ValueError, match=rf"{path}: source has nothing: triangles"):
        imported.read(path)
    shutil.copy(FILES / "with_include.inp", tmp_path)
    with pytest.raises(FileNotFoundError, match=r"with_include\.inp needs .*bulk\.inp"):
        imported.read(tmp_path / "with_include.inp")
