"""The public names: what static tools read, and the list from which ``__init__.py`` loads.

A name that comes from a room (``ngepc.model``) is a module, others are classes and functions.
"""

from ngepc import geometries as geometries
from ngepc import pictures as pictures
from ngepc._version import __version__ as __version__
from ngepc.bounds.adaptive import solve_to as solve_to
from ngepc.bounds.bound import ErrorBound as ErrorBound
from ngepc.bounds.bound import error_bound as error_bound
from ngepc.dual.newton import NewtonOptions as NewtonOptions
from ngepc.dual.newton import semismooth_newton as semismooth_newton
from ngepc.dual.parameters import DualParameters as DualParameters
from ngepc.dual.regularisation import Coupled as Coupled
from ngepc.dual.result import DualResult as DualResult
from ngepc.dual.spaces import DualSpaces as DualSpaces
from ngepc.dual.spaces import Units as Units
from ngepc.dual.tichonov import Fractional as Fractional
from ngepc.dual.tichonov import FullProduct as FullProduct
from ngepc.dual.tichonov import SurfaceGradient as SurfaceGradient
from ngepc.evolution.load_path import Schedule as Schedule
from ngepc.evolution.load_path import load_cycle as load_cycle
from ngepc.evolution.result import Evolution as Evolution
from ngepc.evolution.solver import cold_start as cold_start
from ngepc.evolution.solver import evolve as evolve
from ngepc.linalg.linesearch import Armijo as Armijo
from ngepc.local.result import ExactResult as ExactResult
from ngepc.model import obstacles as obstacles
from ngepc.model.contact import Contact as Contact
from ngepc.model.examples import lshape_problem as lshape_problem
from ngepc.model.examples import wrench_problem as wrench_problem
from ngepc.model.friction import Coulomb as Coulomb
from ngepc.model.kinematics import Kinematics as Kinematics
from ngepc.model.material import Material as Material
from ngepc.model.material import lame_parameters as lame_parameters
from ngepc.model.normals import outward_normal as outward_normal
from ngepc.model.problem import Problem as Problem
from ngepc.path.options import PathOptions as PathOptions
from ngepc.path.result import PathResult as PathResult
from ngepc.path.solver import follow_path as follow_path
from ngepc.pictures.curves import plot_history as plot_history
from ngepc.pictures.export import export_vtu as export_vtu
from ngepc.pictures.fields import plot_field as plot_field
from ngepc.pictures.fields import plot_plastic_zone as plot_plastic_zone
from ngepc.pictures.monitors import live_plot_monitor as live_plot_monitor
from ngepc.pictures.monitors import table_monitor as table_monitor
from ngepc.pictures.report import write_report as write_report
from ngepc.pictures.views import export_html as export_html
from ngepc.pictures.views import show as show
from ngepc.primal.result import PrimalResult as PrimalResult
from ngepc.primal.run import PrimalOptions as PrimalOptions
from ngepc.primal.solver import primal_newton as primal_newton
from ngepc.results.fields import Fields as Fields
from ngepc.results.outcome import SolverError as SolverError
from ngepc.results.outcome import Status as Status
from ngepc.theory.duality import duality_report as duality_report
from ngepc.theory.shifts import augmented_lagrangian as augmented_lagrangian
