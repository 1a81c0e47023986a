"""nassim: multibody simulation with reduced-order flexible bodies."""

from nassim.condensation import Condensation, condense
from nassim.fem import FEModel, build_fe_model
from nassim.geometry import NearestTo, OnPlane, RemotePoint, Solid, read_solid
from nassim.materials import Material
from nassim.piezo import PiezoStack
from nassim.reduction import ReducedBody, craig_bampton
from nassim.storage import load, save

__version__ = "0.1.0"
