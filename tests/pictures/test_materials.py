"""The stress-strain curve of a material is that of a bar."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.pyplot import close
from ngsolve import CF

from ngepc import Hill, Material, Norton, Problem, plot_material
from ngepc.geometries import block
from ngepc.pictures import UnitNames, materials
from ngepc.pictures.wording import describe_material, describe_problem

STEEL = {"young": 210e3, "poisson": 0.3, "yield_stress": 210.0, "tangent_modulus": 2e3}
METAL = Material.metal(**STEEL, kind="kinematic")
MPA = UnitNames(stress="MPa")


def test_the_curve_is_that_of_a_bar():
    figure = plot_material(METAL, units=MPA)
    (axes,) = figure.axes
    there, back = (line.get_xydata() for line in axes.lines[:2])
    assert there[0].tolist() == [0.0, 0.0]
    assert there[-1] == pytest.approx([0.01, 210.0 + 2e3 * 0.009])
    assert back[:, 0].min() == pytest.approx(-0.01)
    assert np.ptp(back[:, 1]) > 400
    assert axes.get_ylabel() == "axial stress (MPa)"
    close(figure)


def test_several_materials_have_labels():
    materials = {
        kind: Material.metal(**STEEL, kind=kind) for kind in ("isotropic", "kinematic")
    }
    figure = plot_material(materials, strain=0.02)
    texts = figure.axes[0].get_legend().get_texts()
    assert [text.get_text() for text in texts] == list(materials)
    close(figure)


def test_a_material_with_a_rate_has_a_curve_for_each_of_three_rates():
    # perfectly plastic beyond R: in a steady flow the overstress is K (rate)^(1/n)
    law = Norton(overstress=300.0, exponent=5.0)
    flat = {"young": 210e3, "poisson": 0.3, "yield_stress": 210.0}
    viscous = Material.metal(**flat, plastic_modulus=1e-3, rate=law)
    figure = plot_material({"steel": viscous})
    axes = figure.axes[0]
    loaded = axes.lines[:6:2]
    for line, part in zip(loaded, (0.1, 0.3, 1.0), strict=True):
        rate = float(f"{law.rate(part * 210.0):.0e}")
        assert line.get_label() == f"steel, rate {rate:g}"
        assert line.get_ydata()[-1] == pytest.approx(210 + law.stress(rate), rel=1e-3)
    close(figure)


def test_bad_arguments_are_named():
    with pytest.raises(TypeError, match="materials"):
        plot_material(3.0)
    with pytest.raises(ValueError, match="strain=0"):
        plot_material(METAL, strain=0.0)
    varies = Material.metal(**STEEL | {"young": CF(210e3)})
    with pytest.raises(ValueError, match="strain=None: a number is needed"):
        plot_material(varies)
    close("all")


def test_axes_are_judged_before_a_bar_is_pulled(monkeypatch):
    def pulled(*_, **__):
        raise AssertionError("a bar was pulled")

    monkeypatch.setattr(materials, "material_point", pulled)
    with pytest.raises(TypeError, match="axes=3"):
        plot_material(METAL, axes=3)


def test_reports_show_engineering_constants():
    problem = Problem(block.structured_mesh(1, 1), METAL)
    said = {row["quantity"]: row["value"] for row in describe_problem(problem, MPA)}
    assert float(said["Young's modulus E"].split()[0]) == 210e3
    assert said["Young's modulus E"].endswith(" MPa")
    assert said["Poisson's ratio"] == "0.3"
    assert said["yield stress R of a tensile test"] == "210 MPa"
    assert said["slope of the stress-strain curve beyond yielding"] == "2000 MPa"
    assert said["hardening"] == "kinematic"
    assert "lame mu" not in said


def test_reports_name_rates_anisotropy_and_sub_elements():
    law = Norton(overstress=300.0, exponent=5.0)
    given = {"young": 210e3, "poisson": 0.3}
    viscous = Material.metal(**given, yield_stress=210.0, plastic_modulus=0, rate=law)
    said = {row["quantity"]: row["value"] for row in describe_material(viscous)}
    words = "Norton, overstress 300, exponent 5"
    assert said["overstress of the rate of plastic strain"] == words

    rolled = replace(viscous, hill=Hill(F=0.4))
    said = {row["quantity"]: row["value"] for row in describe_material(rolled)}
    assert said["overstress of the rate of plastic strain"] == words
    assert said["anisotropic yield"].startswith("Hill, F 0.4, G 0.5")

    curve = [(0.001, 200.0), (0.003, 300.0), (0.01, 400.0)]
    cyclic = Material.cyclic(**given, curve=curve)
    said = {row["quantity"]: row["value"] for row in describe_material(cyclic)}
    assert said["hardening"] == "cyclic, 3 sub-elements"
    assert said["stress-strain curve"].startswith("3 points, from 200 to 400")
    overlay = cyclic.overlay
    layers = Material(
        lame_lambda=1e5, lame_mu=8e4, yield_stress=overlay.bounds[0], overlay=overlay
    )
    said = {row["quantity"]: row["value"] for row in describe_material(layers)}
    assert said["hardening"] == "3 sub-elements"  # one never yields
