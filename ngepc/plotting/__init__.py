"""Pictures: fields and curves for papers (matplotlib); ``ngepc.plotting.views`` for the screen."""

from ngepc.plotting.active_sets import plot_active_sets as plot_active_sets
from ngepc.plotting.curves import plot_contact_pressure as plot_contact_pressure
from ngepc.plotting.curves import plot_counts as plot_counts
from ngepc.plotting.curves import plot_history as plot_history
from ngepc.plotting.curves import plot_quotients as plot_quotients
from ngepc.plotting.drawable import UnitNames as UnitNames
from ngepc.plotting.fields import plot_comparison as plot_comparison
from ngepc.plotting.fields import plot_field as plot_field
from ngepc.plotting.fields import plot_mesh as plot_mesh
from ngepc.plotting.fields import plot_plastic_zone as plot_plastic_zone
from ngepc.plotting.fields import plot_yield_function as plot_yield_function
from ngepc.plotting.picture import Picture as Picture
from ngepc.plotting.progress import plot_progress as plot_progress
