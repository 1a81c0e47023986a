from . import (
    base as base,
)
from . import (
    bodies as bodies,
)
from . import (
    exchange as exchange,
)
from . import (
    fem as fem,
)
from . import (
    identification as identification,
)
from . import (
    kinematics as kinematics,
)
from . import (
    plotting as plotting,
)
from . import (
    scene as scene,
)
from . import (
    signals as signals,
)
from . import (
    simulation as simulation,
)
from . import (
    studies as studies,
)
from . import (
    systems as systems,
)
from . import (
    viewer as viewer,
)
from .base.file_registry import (
    register as register,
)
from .base.storage import (
    load as load,
)
from .base.storage import (
    save as save,
)
from .bodies.interface import (
    RemotePoint as RemotePoint,
)
from .bodies.piezo import (
    ElectricalPort as ElectricalPort,
)
from .bodies.piezo import (
    PiezoStack as PiezoStack,
)
from .bodies.projection import (
    open_circuit as open_circuit,
)
from .bodies.reduced_body import (
    ReducedBody as ReducedBody,
)
from .exchange.export import (
    export_body as export_body,
)
from .exchange.inspection import (
    Report as Report,
)
from .exchange.inspection import (
    check as check,
)
from .exchange.repairing import (
    Repair as Repair,
)
from .exchange.repairing import (
    repair as repair,
)
from .exchange.repairing import (
    to_body as to_body,
)
from .exchange.superelement import (
    Superelement as Superelement,
)
from .exchange.superelement import (
    read_superelement as read_superelement,
)
from .fem.assembly import (
    build_fe_model as build_fe_model,
)
from .fem.condensation import (
    Condensation as Condensation,
)
from .fem.condensation import (
    condense as condense,
)
from .fem.fe_model import (
    FEModel as FEModel,
)
from .fem.materials import (
    Material as Material,
)
from .fem.reduction import (
    craig_bampton as craig_bampton,
)
from .fem.solid import (
    NearestTo as NearestTo,
)
from .fem.solid import (
    OnPlane as OnPlane,
)
from .fem.solid import (
    Solid as Solid,
)
from .fem.solid import (
    read_solid as read_solid,
)
from .identification.apply import (
    apply_identification as apply_identification,
)
from .identification.modal_fit import (
    ModalFit as ModalFit,
)
from .identification.modal_fit import (
    identify_modes as identify_modes,
)
from .scene.bodies import (
    FlexibleBody as FlexibleBody,
)
from .scene.bodies import (
    RigidBody as RigidBody,
)
from .scene.drives import (
    Drive as Drive,
)
from .scene.instruments import (
    Accelerometer as Accelerometer,
)
from .scene.instruments import (
    ForceSensor as ForceSensor,
)
from .scene.instruments import (
    Geophone as Geophone,
)
from .scene.instruments import (
    Vibrometer as Vibrometer,
)
from .scene.joints import (
    Joint as Joint,
)
from .scene.joints import (
    cylindrical as cylindrical,
)
from .scene.joints import (
    fixed as fixed,
)
from .scene.joints import (
    planar as planar,
)
from .scene.joints import (
    prismatic as prismatic,
)
from .scene.joints import (
    revolute as revolute,
)
from .scene.joints import (
    spherical as spherical,
)
from .scene.joints import (
    universal as universal,
)
from .scene.loop import (
    Loop as Loop,
)
from .scene.piezo import (
    StackActuator as StackActuator,
)
from .scene.piezo import (
    StackSensor as StackSensor,
)
from .scene.piezo import (
    VoltageDrive as VoltageDrive,
)
from .scene.piezo import (
    VoltageSensor as VoltageSensor,
)
from .scene.placement import (
    joined as joined,
)
from .scene.placement import (
    placed as placed,
)
from .scene.scene import (
    Scene as Scene,
)
from .signals.files import (
    read_frf as read_frf,
)
from .signals.files import (
    read_record as read_record,
)
from .signals.files import (
    write_record as write_record,
)
from .signals.frf import (
    FRF as FRF,
)
from .signals.frf import (
    estimate_frf as estimate_frf,
)
from .signals.time_history import (
    TimeHistory as TimeHistory,
)
from .simulation.linear.linearization import (
    linearize as linearize,
)
from .simulation.linear.stopped_runs import (
    SimulationError as SimulationError,
)
from .simulation.model.accuracy import (
    truncation_error as truncation_error,
)
from .simulation.model.description import (
    describe as describe,
)
from .simulation.model.scene_body import (
    reduce_scene as reduce_scene,
)
from .simulation.model.trimming import (
    trim_scene as trim_scene,
)
from .simulation.run.simulate import (
    simulate as simulate,
)
from .simulation.run.simulate import (
    simulate_motion as simulate_motion,
)
from .simulation.run.simulate import (
    static_response as static_response,
)
from .simulation.run.simulation import (
    Simulation as Simulation,
)
from .systems.controllers import (
    Controller as Controller,
)
from .systems.linear_model import (
    LinearModel as LinearModel,
)
from .systems.linear_model import (
    frequency_response as frequency_response,
)
from .systems.noise_budget import (
    NoiseBudget as NoiseBudget,
)
from .systems.noise_budget import (
    noise_budget as noise_budget,
)
from .systems.python_controller import (
    PythonController as PythonController,
)

__version__: str
from .scene.mechanics import (
    AngleSensor as AngleSensor,
)
from .scene.mechanics import (
    Bushing as Bushing,
)
from .scene.mechanics import (
    Encoder as Encoder,
)
from .scene.mechanics import (
    GroundAcceleration as GroundAcceleration,
)
from .scene.mechanics import (
    LinearActuator as LinearActuator,
)
from .scene.mechanics import (
    PointForce as PointForce,
)
from .scene.mechanics import (
    PointTorque as PointTorque,
)
from .scene.mechanics import (
    Pose as Pose,
)
from .scene.mechanics import (
    SpringDamper as SpringDamper,
)
