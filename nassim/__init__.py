"""nassim: multibody simulation with reduced-order flexible bodies."""

from nassim.exchange.acceptance import Repair, repair, to_body
from nassim.scene.bodies import FlexibleBody, RigidBody
from nassim.bodies.reduced_body import ReducedBody
from nassim.fem.condensation import Condensation, condense
from nassim.systems.controllers import Controller
from nassim.fem.reduction import craig_bampton
from nassim.simulation.description import describe
from nassim.exchange.export import export_body
from nassim.fem.assembly import build_fe_model
from nassim.fem.fe_model import FEModel
from nassim.signals.frf import FRF, estimate_frf
from nassim.identification.modal_fit import ModalFit, identify_modes
from nassim.exchange.inspection import Report, check
from nassim.bodies.interface import RemotePoint
from nassim.systems.linear_model import LinearModel, frequency_response
from nassim.simulation.linearization import linearize, truncation_error
from nassim.scene.loop import Loop
from nassim.fem.materials import Material
from nassim.signals.files import read_frf, read_record, write_record
from nassim.scene.mechanics import Encoder, GroundAcceleration, Joint, PointForce, SpringDamper
from nassim.base.nouns import register
from nassim.bodies.piezo import ElectricalPort, PiezoStack
from nassim.scene.scene import Scene
from nassim.signals.time_history import TimeHistory
from nassim.simulation.time_domain import simulate, static_response
from nassim.fem.solid import NearestTo, OnPlane, Solid, read_solid
from nassim.scene.piezo import StackActuator, StackSensor, VoltageDrive, VoltageSensor
from nassim.base.storage import load, save
from nassim.exchange.superelement import Superelement, read_superelement
from nassim.bodies.projection import open_circuit
from nassim.simulation.trimming import trim_scene
from nassim.identification.apply import apply_identification

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
