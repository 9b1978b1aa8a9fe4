# The public names of this room and their homes, for type checkers and for lazy_loader.

from .batch import EvaluatedQuantity as EvaluatedQuantity
from .batch import compliance as compliance
from .batch import evaluate as evaluate
from .batch import stiffness as stiffness
from .buckling import BucklingLoad as BucklingLoad
from .buckling import buckling_load as buckling_load
from .condensation import CartesianCompliance as CartesianCompliance
from .condensation import transformed_compliance as transformed_compliance
from .condensation import transformed_stiffness as transformed_stiffness
from .condensation import twist_transform as twist_transform
from .elastic_model import ElasticModel as ElasticModel
from .elastic_model import SpringBlock as SpringBlock
from .loaded import LoadedEquilibrium as LoadedEquilibrium
from .loaded import equilibrium_path as equilibrium_path
from .loaded import load_deflection as load_deflection
from .loaded import loaded_equilibrium as loaded_equilibrium
from .loads import Loads as Loads
from .report import cartesian_compliance as cartesian_compliance
from .springs import AxialSpring as AxialSpring
from .springs import BeamSpring as BeamSpring
from .springs import CantileverSpring as CantileverSpring
from .springs import ClosureSpring as ClosureSpring
from .springs import JointLength as JointLength
from .springs import JointSpring as JointSpring
from .springs import Spring as Spring
from .springs import read_springs as read_springs
