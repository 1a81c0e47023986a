"""nassim: multibody simulation with reduced-order flexible bodies."""

from nassim.body import ReducedBody
from nassim.condensation import Condensation, condense
from nassim.fem import FEModel, build_fe_model
from nassim.frf import FRF, estimate_frf
from nassim.geometry import NearestTo, OnPlane, RemotePoint, Solid, read_solid
from nassim.linear import LinearModel, frequency_response, linearize, truncation_error
from nassim.materials import Material
from nassim.parts import (
    Encoder,
    FlexibleBody,
    GroundAcceleration,
    Joint,
    Loop,
    PointForce,
    RigidBody,
    SpringDamper,
    StackActuator,
    StackSensor,
    VoltageDrive,
    VoltageSensor,
)
from nassim.piezo import ElectricalPort, PiezoStack
from nassim.reduction import craig_bampton
from nassim.scene import Scene
from nassim.signals import TimeHistory
from nassim.simulation import simulate, static_response
from nassim.storage import load, save

__version__ = "0.1.0"

__all__ = [
    "FRF",
    "Condensation",
    "ElectricalPort",
    "Encoder",
    "FEModel",
    "FlexibleBody",
    "GroundAcceleration",
    "Joint",
    "LinearModel",
    "Loop",
    "Material",
    "NearestTo",
    "OnPlane",
    "PiezoStack",
    "PointForce",
    "ReducedBody",
    "RemotePoint",
    "RigidBody",
    "Scene",
    "Solid",
    "SpringDamper",
    "StackActuator",
    "StackSensor",
    "TimeHistory",
    "VoltageDrive",
    "VoltageSensor",
    "build_fe_model",
    "condense",
    "craig_bampton",
    "estimate_frf",
    "frequency_response",
    "linearize",
    "load",
    "read_solid",
    "save",
    "simulate",
    "static_response",
    "truncation_error",
]
