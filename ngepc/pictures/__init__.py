"""Pictures: fields and curves for papers (matplotlib); ``ngepc.pictures.views`` for the screen.

- figures of bodies: fields, meshes, materials, collapse, stills
- curves: curves, intervals
- what is drawn: drawable, sampling, cutting, style
- for the screen: views, live, live_server, sliders, monitors, course
- files: report, export, vtu
- descriptions in words and numbers: wording, answers, quantities, rows
"""

from ngepc.pictures.curves import plot_contact_pressure as plot_contact_pressure
from ngepc.pictures.curves import plot_counts as plot_counts
from ngepc.pictures.curves import plot_curve as plot_curve
from ngepc.pictures.curves import plot_history as plot_history
from ngepc.pictures.drawable import UnitNames as UnitNames
from ngepc.pictures.fields import plot_active_sets as plot_active_sets
from ngepc.pictures.fields import plot_field as plot_field
from ngepc.pictures.fields import plot_mesh as plot_mesh
from ngepc.pictures.fields import plot_plastic_zone as plot_plastic_zone
from ngepc.pictures.style import Picture as Picture
from ngepc.pictures.style import beside as beside
