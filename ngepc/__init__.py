"""ngepc: elasto-plastic contact with NGSolve."""

import logging
from pathlib import Path

from ngepc._version import __version__ as __version__
from ngepc.linesearch import Armijo as Armijo
from ngepc.material import Material as Material
from ngepc.material import lame_parameters as lame_parameters
from ngepc.newton import NewtonOptions as NewtonOptions
from ngepc.newton import semismooth_newton as semismooth_newton
from ngepc.normals import outward_normal as outward_normal
from ngepc.problem import Problem as Problem
from ngepc.regularisation import Coupled as Coupled
from ngepc.regularisation import Units as Units
from ngepc.results import SolverError as SolverError
from ngepc.results import Status as Status

logging.getLogger(__name__).addHandler(logging.NullHandler())

_checkout = Path(__file__).resolve().parent.parent
if (_checkout / "geometries" / "bisection.py").is_file() and "geometries" not in __path__:
    __path__.append(str(_checkout))  # run from a checkout: geometries/ stands beside ngepc/
