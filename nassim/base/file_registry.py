"""The nouns that files hold, under public names that outlive moves of their modules.

A file names a noun by its class's own name. This table says where the class lives, as text, so that reading a record
does not load what meshes and reduces. A file can ask for no class that is not in it.
"""

import importlib
from typing import Any, TypeGuard, TypeVar

Noun = TypeVar("Noun")

NOUNS: dict[str, str] = {
    "Accelerometer": "nassim.scene.instruments",
    "AngleSensor": "nassim.scene.mechanics",
    "Bushing": "nassim.scene.mechanics",
    "LinearActuator": "nassim.scene.mechanics",
    "PointTorque": "nassim.scene.mechanics",
    "Pose": "nassim.scene.mechanics",
    "Calibration": "nassim.identification.calibration",
    "Change": "nassim.identification.apply",
    "Controller": "nassim.systems.controllers",
    "Drive": "nassim.scene.drives",
    "ElectricalPort": "nassim.bodies.piezo",
    "Encoder": "nassim.scene.mechanics",
    "FRF": "nassim.signals.frf",
    "Finding": "nassim.exchange.inspection",
    "FlexibleBody": "nassim.scene.bodies",
    "FoldingMode": "nassim.systems.folding",
    "ForceSensor": "nassim.scene.instruments",
    "FloatingFrame": "nassim.bodies.floating_frame",
    "Geophone": "nassim.scene.instruments",
    "GroundAcceleration": "nassim.scene.mechanics",
    "HarmonicSolution": "nassim.fem.full_model",
    "Joint": "nassim.scene.joints",
    "LinearModel": "nassim.systems.linear_model",
    "Loop": "nassim.scene.loop",
    "Margins": "nassim.systems.feedback",
    "Material": "nassim.fem.materials",
    "ModalFit": "nassim.identification.modal_fit",
    "Motion": "nassim.scene.motion",
    "NearestTo": "nassim.fem.solid",
    "NoiseBudget": "nassim.systems.noise_budget",
    "OnPlane": "nassim.fem.solid",
    "Optimum": "nassim.systems.root_locus",
    "OrderGuess": "nassim.exchange.row_order",
    "Parameter": "nassim.identification.calibration",
    "PassivePoint": "nassim.bodies.readouts",
    "Picture": "nassim.bodies.readouts",
    "PiezoStack": "nassim.bodies.piezo",
    "PointForce": "nassim.scene.mechanics",
    "PortCoupling": "nassim.bodies.piezo",
    "ReducedBody": "nassim.bodies.reduced_body",
    "RemotePoint": "nassim.bodies.interface",
    "Repair": "nassim.exchange.repairing",
    "Report": "nassim.exchange.inspection",
    "RigidBody": "nassim.scene.bodies",
    "RigidInertia": "nassim.bodies.inertia",
    "RootLocus": "nassim.systems.root_locus",
    "Samples": "nassim.studies.samples",
    "Scene": "nassim.scene.scene",
    "SpringDamper": "nassim.scene.mechanics",
    "StackActuator": "nassim.scene.piezo",
    "StackSensor": "nassim.scene.piezo",
    "StewartPlatform": "nassim.kinematics.stewart",
    "Strain": "nassim.bodies.strain",
    "Superelement": "nassim.exchange.superelement",
    "Surface": "nassim.bodies.readouts",
    "TabulatedSpectrum": "nassim.signals.spectra",
    "Target": "nassim.identification.calibration",
    "TimeHistory": "nassim.signals.time_history",
    "Trace": "nassim.bodies.readouts",
    "UnstablePole": "nassim.systems.linear_model",
    "UpdateReport": "nassim.identification.apply",
    "Vibrometer": "nassim.scene.instruments",
    "VoltageDrive": "nassim.scene.piezo",
    "VoltageSensor": "nassim.scene.piezo",
}
"""Public name of each noun of nassim -> the module in which its class lives."""

UPGRADES: dict[str, str] = {
    "ModalFit": "nassim.identification.modal_fit:upgraded_fit",
    "ReducedBody": "nassim.bodies.readouts:upgraded_readouts",
}
"""Public name -> function, as "module:name", from a noun's fields in a file of an older format to those of today.

It is given the fields by name; those that are nouns are made already.
"""

_registered: dict[str, type] = {}


def register(noun: type[Noun]) -> type[Noun]:
    """Let `save` and `load` know a dataclass of your own, under its name; to be written above its `@dataclass`.

    A script that loads the file must have registered it too. Raises ValueError for what is not a dataclass, and for a
    name that another class has; the same class defined anew, as in a notebook, takes the place of the earlier one.
    """
    if not (isinstance(noun, type) and "__dataclass_fields__" in vars(noun)):
        raise ValueError(
            f"register takes a dataclass, got {getattr(noun, '__name__', noun)!r}; write @register above @dataclass"
        )
    taken = _known(noun.__name__) or noun
    if (taken.__module__, taken.__qualname__) != (noun.__module__, noun.__qualname__):
        raise ValueError(
            f"the name {noun.__name__!r} is taken by {taken.__module__}.{taken.__qualname__}; give the class another"
        )
    _registered[noun.__name__] = noun
    return noun


def find(name: str) -> type:
    """The noun with a public name; raises ValueError when there is none."""
    noun = _known(name)
    if noun is None:
        raise ValueError(
            f"it holds a {name!r}, which is no noun that this nassim knows; upgrade nassim, or, where it is a "
            "dataclass of your own, give that to nassim.register before loading"
        )
    return noun


def upgraded(name: str, content: dict[str, Any]) -> dict[str, Any]:
    """A noun's fields in a file of an older format as those of today."""
    if name not in UPGRADES:
        return content
    module, _, function = UPGRADES[name].partition(":")
    result: dict[str, Any] = getattr(importlib.import_module(module), function)(content)
    return result


def is_noun(value: object) -> TypeGuard[Any]:
    """Whether a value is of a class that files hold."""
    return _known(type(value).__name__) is type(value)


def _known(name: str) -> type | None:
    if name not in NOUNS:
        return _registered.get(name)
    noun: type = getattr(importlib.import_module(NOUNS[name]), name)
    return noun
