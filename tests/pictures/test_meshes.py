"""Meshes and problems before a solve: every name is said, with what happens there."""

import numpy as np
import pytest
from browser import Browser, chromium
from netgen.occ import Glue, OCCGeometry, Rectangle
from ngsolve import Mesh
from solved import two_blocks

from ngepc import lshape_problem, show
from ngepc.geometries import lshape
from ngepc.pictures import plot_mesh, views
from ngepc.pictures.meshes import (
    _sets,
    boundary_colours,
    boundary_labels,
    legend_of_names,
)


def legend_of(figure):
    return [text.get_text() for text in figure.axes[0].get_legend().get_texts()]


def test_labels_say_what_happens_at_each_boundary():
    problem = lshape_problem(lshape.paper_mesh(113))
    assert boundary_labels(problem) == {
        "clamped": "clamped",
        "contact": "contact",
        "free": "free",
        "load": "load: traction",
    }
    assert boundary_labels(problem.mesh)["load"] == "load"
    said = boundary_labels(two_blocks().problem)
    assert said["over"] == "over: contact"
    assert said["under"] == "under: contact"
    assert said["top"] == "top: pressure"
    assert said["side"] == "side: prescribed"


def test_figures_name_boundaries_and_bodies():
    problem = lshape_problem(lshape.paper_mesh(113))
    assert legend_of(plot_mesh(problem))[-1] == "load: traction"
    lines = plot_mesh(problem.mesh).axes[0].collections
    drawn = {
        tuple(c.get_colors()[0][:3])
        for c in lines
        if len(c.get_linewidths()) and c.get_linewidths()[0] > 2
    }
    assert drawn == set(boundary_colours(problem.mesh).values())
    cut = plot_mesh(two_blocks().problem, cut=((0.5, 0.5, 0.5), (0.0, -1.0, 0.0)))
    assert {"body lower", "body upper"} <= set(legend_of(cut))


def test_what_is_no_mesh_is_refused():
    with pytest.raises(TypeError, match="a mesh, a Problem, the result"):
        plot_mesh("block")


@pytest.mark.skipif(
    chromium() is None or not views.viewer_installed(), reason="no browser or viewer"
)
@pytest.mark.parametrize("solid", [False, True])
def test_pages_name_boundaries(solid, tmp_path):
    problem = two_blocks().problem if solid else lshape_problem(lshape.paper_mesh(113))
    path = show(problem).save(tmp_path / "mesh.html")
    with Browser() as tab:
        seen = tab.open(path)
        tab.wait_for("document.body.dataset.frame !== undefined")
        tab.settle()
        text = tab.evaluate("document.querySelector('.lines').textContent")
        for label in boundary_labels(problem).values():
            assert label in text
        assert (np.ptp(tab.pixels(), axis=2) > 0.02).mean() > 0.005
        assert seen.errors == []
        assert seen.requests == []


def test_numbers_have_their_colours():
    colours = {"a": (1.0, 0.0, 0.0), "b": (0.0, 1.0, 0.0), "c": (0.0, 0.0, 1.0)}
    mapped = _sets(None, colours)[1]
    for number, colour in enumerate(colours.values()):
        assert mapped.to_rgba(float(number))[:3] == colour


def test_legends_name_the_bodies_of_a_plane_mesh():
    """Those of several; in space the colours are those of the surface."""
    plane = Mesh(
        OCCGeometry(
            Glue(
                [
                    Rectangle(1, 1).Face().Move((0, 0, 0)),
                    Rectangle(1, 1).Face().Move((1, 0, 0)),
                ]
            ),
            dim=2,
        ).GenerateMesh(maxh=1.0)
    )
    plane.ngmesh.SetMaterial(1, "copper")
    plane.ngmesh.SetMaterial(2, "tin")
    legend = legend_of_names(plane)
    assert "copper" in legend
    assert "tin" in legend
    solid = legend_of_names(two_blocks().problem.mesh)
    assert "upper" not in solid
