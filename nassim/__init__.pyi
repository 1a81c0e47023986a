from . import (
    base as base,
    bodies as bodies,
    exchange as exchange,
    fem as fem,
    identification as identification,
    kinematics as kinematics,
    plotting as plotting,
    scene as scene,
    signals as signals,
    simulation as simulation,
    studies as studies,
    systems as systems,
    viewer as viewer,
)
from .base.file_registry import (
    register as register,
)
from .base.storage import (
    load as load,
    save as save,
)
from .bodies.comparison import (
    compare as compare,
)
from .bodies.piezo import (
    ElectricalPort as ElectricalPort,
    PiezoStack as PiezoStack,
)
from .bodies.projection import (
    open_circuit as open_circuit,
)
from .bodies.reduced_body import (
    ReducedBody as ReducedBody,
)
from .bodies.remote_points import (
    RemotePoint as RemotePoint,
)
from .bodies.stress import (
    principal_stresses as principal_stresses,
    von_mises as von_mises,
)
from .exchange.export import (
    export_body as export_body,
)
from .exchange.inspection import (
    Report as Report,
    check as check,
)
from .exchange.repairing import (
    Repair as Repair,
    repair as repair,
    to_body as to_body,
)
from .exchange.superelements import (
    Superelement as Superelement,
    read_superelement as read_superelement,
)
from .fem.accuracy import (
    build_fe_model as build_fe_model,
)
from .fem.condensation import (
    Condensation as Condensation,
    condense as condense,
)
from .fem.face_picks import (
    Extreme as Extreme,
    NearestTo as NearestTo,
    OfColour as OfColour,
    OnBody as OnBody,
    OnCylinder as OnCylinder,
    OnPlane as OnPlane,
    name_faces as name_faces,
)
from .fem.face_tables import (
    face_table as face_table,
)
from .fem.faces import (
    list_faces as list_faces,
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
    Solid as Solid,
    read_solid as read_solid,
)
from .fem.stress_places import (
    GaugeLine as GaugeLine,
    StressPoint as StressPoint,
    StressSurface as StressSurface,
)
from .identification.apply import (
    apply_identification as apply_identification,
)
from .identification.modal_fit import (
    ModalFit as ModalFit,
    identify_modes as identify_modes,
)
from .scene.bodies import (
    FlexibleBody as FlexibleBody,
    RigidBody as RigidBody,
)
from .scene.drives import (
    Drive as Drive,
)
from .scene.instruments import (
    Accelerometer as Accelerometer,
    ForceSensor as ForceSensor,
    Geophone as Geophone,
    Vibrometer as Vibrometer,
)
from .scene.joints import (
    Joint as Joint,
    cylindrical as cylindrical,
    fixed as fixed,
    planar as planar,
    prismatic as prismatic,
    revolute as revolute,
    spherical as spherical,
    universal as universal,
)
from .scene.loop import (
    Loop as Loop,
)
from .scene.piezo import (
    StackActuator as StackActuator,
    StackSensor as StackSensor,
    VoltageDrive as VoltageDrive,
    VoltageSensor as VoltageSensor,
)
from .scene.placement import (
    joined as joined,
    placed as placed,
)
from .scene.scene import (
    Scene as Scene,
)
from .scene.stress_peaks import (
    peak_stress as peak_stress,
)
from .scene.stress_sensors import (
    StrainGauge as StrainGauge,
    StressAt as StressAt,
)
from .signals.files import (
    read_frf as read_frf,
    read_record as read_record,
    write_record as write_record,
)
from .signals.frf import (
    FRF as FRF,
    estimate_frf as estimate_frf,
)
from .signals.time_history import (
    TimeHistory as TimeHistory,
)
from .simulation.linear.linearization import (
    linearize as linearize,
)
from .simulation.linear.truncation import (
    truncation_error as truncation_error,
)
from .simulation.loaded.scene_body import (
    reduce_scene as reduce_scene,
)
from .simulation.loaded.stress_convergence import (
    stress_convergence as stress_convergence,
)
from .simulation.loaded.stress_limits import (
    load_limit as load_limit,
    static_motion as static_motion,
)
from .simulation.model.description import (
    describe as describe,
)
from .simulation.model.stopped_runs import (
    SimulationError as SimulationError,
)
from .simulation.model.trimming import (
    trim_scene as trim_scene,
)
from .simulation.run.simulate import (
    simulate as simulate,
    simulate_motion as simulate_motion,
    static_response as static_response,
)
from .simulation.run.step_by_step import (
    Simulation as Simulation,
)
from .systems.controllers import (
    Controller as Controller,
)
from .systems.fatigue import (
    WoehlerLine as WoehlerLine,
    count_cycles as count_cycles,
    damage_rate as damage_rate,
)
from .systems.linear_model import (
    LinearModel as LinearModel,
    frequency_response as frequency_response,
)
from .systems.noise_budgets import (
    NoiseBudget as NoiseBudget,
    noise_budget as noise_budget,
)
from .systems.python_controller import (
    PythonController as PythonController,
)

__version__: str
from .scene.forces import (
    GroundAcceleration as GroundAcceleration,
    LinearActuator as LinearActuator,
    PointForce as PointForce,
    PointTorque as PointTorque,
)
from .scene.motion_sensors import (
    AngleSensor as AngleSensor,
    Encoder as Encoder,
    Pose as Pose,
)
from .scene.springs import (
    Bushing as Bushing,
    SpringDamper as SpringDamper,
)
from .scene.voice_coil import (
    CurrentSensor as CurrentSensor,
    VoiceCoil as VoiceCoil,
)
from .systems.stress_noise import (
    von_mises_budget as von_mises_budget,
)
