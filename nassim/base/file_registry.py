"""Registry of the data classes that files may hold.

A file names a data class by the class's own name. This table gives the module of each class as text, so reading a
record does not load the mesher or the reduction. A class can therefore move to another module and old files still load.
A file cannot load a class that is not in the table.
"""

import importlib
from typing import Any, TypeGuard, TypeVar

DataClass = TypeVar("DataClass")

DATA_CLASSES: dict[str, str] = {
    "Accelerometer": "nassim.scene.instruments",
    "AngleSensor": "nassim.scene.motion_sensors",
    "BalancedTruncation": "nassim.systems.model_reduction",
    "BodyDamping": "nassim.bodies.readouts",
    "Bushing": "nassim.scene.springs",
    "Calibration": "nassim.identification.calibration",
    "Change": "nassim.identification.apply",
    "Comparison": "nassim.bodies.comparison",
    "ComplementaryFilters": "nassim.systems.sensor_fusion",
    "Controller": "nassim.systems.controllers",
    "CurrentSensor": "nassim.scene.voice_coil",
    "Drive": "nassim.scene.drives",
    "DriveLimits": "nassim.signals.motion_paths",
    "ElectricalPort": "nassim.bodies.piezo",
    "Encoder": "nassim.scene.motion_sensors",
    "Extreme": "nassim.fem.face_picks",
    "FRF": "nassim.signals.frf",
    "FamilyMargins": "nassim.systems.plant_families",
    "Finding": "nassim.exchange.inspection",
    "FlexibleBody": "nassim.scene.bodies",
    "FloatingFrame": "nassim.bodies.floating_frames",
    "FoldingMode": "nassim.systems.folding",
    "ForceSensor": "nassim.scene.instruments",
    "GaugeLine": "nassim.fem.stress_places",
    "GaugeStrain": "nassim.bodies.stress",
    "Geophone": "nassim.scene.instruments",
    "GroundAcceleration": "nassim.scene.forces",
    "HarmonicSolution": "nassim.fem.full_model",
    "Joint": "nassim.scene.joints",
    "LinearActuator": "nassim.scene.forces",
    "LinearModel": "nassim.systems.linear_model",
    "LoadLimit": "nassim.simulation.loaded.stress_limits",
    "Loop": "nassim.scene.loop",
    "Margins": "nassim.systems.stability_margins",
    "Material": "nassim.fem.materials",
    "ModalFit": "nassim.identification.modal_fit",
    "Motion": "nassim.scene.motion",
    "NearestTo": "nassim.fem.face_picks",
    "NoiseBudget": "nassim.systems.noise_budgets",
    "OfColour": "nassim.fem.face_picks",
    "OnBody": "nassim.fem.face_picks",
    "OnCylinder": "nassim.fem.face_picks",
    "OnPlane": "nassim.fem.face_picks",
    "Optimum": "nassim.systems.root_loci",
    "OrderGuess": "nassim.exchange.row_order",
    "Parameter": "nassim.identification.calibration",
    "PassivePoint": "nassim.bodies.readouts",
    "PeakStress": "nassim.scene.stress_peaks",
    "Picture": "nassim.bodies.readouts",
    "PiezoStack": "nassim.bodies.piezo",
    "PointForce": "nassim.scene.forces",
    "PointTorque": "nassim.scene.forces",
    "PortCoupling": "nassim.bodies.piezo",
    "Pose": "nassim.scene.motion_sensors",
    "ReducedBody": "nassim.bodies.reduced_body",
    "RemotePoint": "nassim.bodies.remote_points",
    "Repair": "nassim.exchange.repairing",
    "Report": "nassim.exchange.inspection",
    "RigidBody": "nassim.scene.bodies",
    "RigidInertia": "nassim.bodies.inertia",
    "RootLocus": "nassim.systems.root_loci",
    "Samples": "nassim.studies.samples",
    "Scene": "nassim.scene.scene",
    "SpringDamper": "nassim.scene.springs",
    "StackActuator": "nassim.scene.piezo",
    "StackSensor": "nassim.scene.piezo",
    "StewartPlatform": "nassim.kinematics.stewart",
    "Strain": "nassim.bodies.strain",
    "StrainGauge": "nassim.scene.stress_sensors",
    "StressAt": "nassim.scene.stress_sensors",
    "StressConvergence": "nassim.simulation.loaded.stress_convergence",
    "StressCycles": "nassim.systems.fatigue",
    "StressField": "nassim.bodies.stress",
    "StressPoint": "nassim.fem.stress_places",
    "StressSpot": "nassim.simulation.loaded.stress_convergence",
    "StressStiffness": "nassim.bodies.stress_stiffness",
    "StressSurface": "nassim.fem.stress_places",
    "Superelement": "nassim.exchange.superelements",
    "Surface": "nassim.bodies.readouts",
    "Synthesis": "nassim.systems.optimal_control",
    "TabulatedSpectrum": "nassim.signals.spectra",
    "Target": "nassim.identification.calibration",
    "TimeHistory": "nassim.signals.time_history",
    "Trace": "nassim.bodies.readouts",
    "UnstablePole": "nassim.systems.linear_model",
    "UpdateReport": "nassim.identification.apply",
    "Vibrometer": "nassim.scene.instruments",
    "VoiceCoil": "nassim.scene.voice_coil",
    "VoltageDrive": "nassim.scene.piezo",
    "VoltageSensor": "nassim.scene.piezo",
    "WoehlerLine": "nassim.systems.fatigue",
}
"""Public name of each data class of nassim -> module in which it is defined."""

UPGRADES: dict[str, str] = {
    "ModalFit": "nassim.identification.modal_fit:upgrade_fit",
    "ReducedBody": "nassim.bodies.readouts:upgrade_readouts",
    "StressStiffness": "nassim.bodies.stress_stiffness:upgrade_stress",
}
"""Public name -> function, as "module:name", that converts the fields of an older file format to those of today.

The function gets the fields by name. Fields that are data classes have already been made.
"""

_registered: dict[str, type] = {}


def register(data_class: type[DataClass]) -> type[DataClass]:
    """Register a dataclass of your own, so that `save` and `load` accept it; write it above `@dataclass`.

    A script that loads the file must register the class too. If a class is defined again, as in a notebook, the new
    definition replaces the earlier one.

    Args:
        data_class: the dataclass; files refer to it by its name

    Returns:
        The same class.

    Raises:
        ValueError: if it is not a dataclass, or another class has the same name
    """
    if not (isinstance(data_class, type) and "__dataclass_fields__" in vars(data_class)):
        raise ValueError(
            f"register takes a dataclass, got {getattr(data_class, '__name__', data_class)!r}; "
            "write @register above @dataclass"
        )
    taken = _known(data_class.__name__) or data_class
    if (taken.__module__, taken.__qualname__) != (data_class.__module__, data_class.__qualname__):
        raise ValueError(
            f"the name {data_class.__name__!r} is taken by {taken.__module__}.{taken.__qualname__}; "
            "give the class another name"
        )
    _registered[data_class.__name__] = data_class
    return data_class


def find(name: str) -> type:
    """Return the data class with a public name.

    Raises:
        ValueError: if no data class has this name
    """
    data_class = _known(name)
    if data_class is None:
        raise ValueError(
            f"it holds a {name!r}, a data class that this nassim does not know; upgrade nassim, or, if it is a "
            "dataclass of your own, give it to nassim.register before loading"
        )
    return data_class


def upgrade_fields(name: str, content: dict[str, Any]) -> dict[str, Any]:
    """Convert the fields of a data class from an older file format to those of today."""
    if name not in UPGRADES:
        return content
    module, _, function = UPGRADES[name].partition(":")
    return getattr(importlib.import_module(module), function)(content)


def is_data_class(value: object) -> TypeGuard[Any]:
    """Return whether a value's class may be held by files."""
    return _known(type(value).__name__) is type(value)


def _known(name: str) -> type | None:
    """Return the class with a public name, or None."""
    if name not in DATA_CLASSES:
        return _registered.get(name)
    return getattr(importlib.import_module(DATA_CLASSES[name]), name)
