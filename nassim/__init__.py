"""nassim: multibody simulation with reduced-order flexible bodies."""

from nassim.acceptance import Repair, repair, to_body
from nassim.bodies import FlexibleBody, RigidBody
from nassim.body import ReducedBody
from nassim.condensation import Condensation, condense
from nassim.control import Controller
from nassim.craig_bampton import craig_bampton
from nassim.describe import describe
from nassim.export import export_body
from nassim.fe_assembly import build_fe_model
from nassim.fe_model import FEModel
from nassim.frf import FRF, estimate_frf
from nassim.identification import ModalFit, identify_modes
from nassim.inspection import Report, check
from nassim.interface import RemotePoint
from nassim.linear import LinearModel, frequency_response
from nassim.linearize import linearize, truncation_error
from nassim.loop import Loop
from nassim.materials import Material
from nassim.measurements import read_frf, read_record, write_record
from nassim.mechanics import Encoder, GroundAcceleration, Joint, PointForce, SpringDamper
from nassim.nouns import register
from nassim.piezo import ElectricalPort, PiezoStack
from nassim.scene import Scene
from nassim.signals import TimeHistory
from nassim.simulation import simulate, static_response
from nassim.solid import NearestTo, OnPlane, Solid, read_solid
from nassim.stacks import StackActuator, StackSensor, VoltageDrive, VoltageSensor
from nassim.storage import load, save
from nassim.superelement import Superelement, read_superelement
from nassim.trim import open_circuit
from nassim.trimming import trim_scene
from nassim.updating import apply_identification

__version__ = "0.2.0.dev0"

__all__ = [
    "FRF",
    "Condensation",
    "Controller",
    "ElectricalPort",
    "Encoder",
    "FEModel",
    "FlexibleBody",
    "GroundAcceleration",
    "Joint",
    "LinearModel",
    "Loop",
    "Material",
    "ModalFit",
    "NearestTo",
    "OnPlane",
    "PiezoStack",
    "PointForce",
    "ReducedBody",
    "RemotePoint",
    "Repair",
    "Report",
    "RigidBody",
    "Scene",
    "Solid",
    "SpringDamper",
    "StackActuator",
    "StackSensor",
    "Superelement",
    "TimeHistory",
    "VoltageDrive",
    "VoltageSensor",
    "apply_identification",
    "build_fe_model",
    "check",
    "condense",
    "craig_bampton",
    "describe",
    "estimate_frf",
    "export_body",
    "frequency_response",
    "identify_modes",
    "linearize",
    "load",
    "open_circuit",
    "read_frf",
    "read_record",
    "read_solid",
    "read_superelement",
    "register",
    "repair",
    "save",
    "simulate",
    "static_response",
    "to_body",
    "trim_scene",
    "truncation_error",
    "write_record",
]
