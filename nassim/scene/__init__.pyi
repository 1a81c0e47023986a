from .bodies import (
    Body as Body,
    FlexibleBody as FlexibleBody,
    RigidBody as RigidBody,
)
from .drives import (
    Drive as Drive,
)
from .field_kinds import (
    Axes as Axes,
    Direction as Direction,
    Path as Path,
    Position as Position,
    Signal as Signal,
)
from .forces import (
    GroundAcceleration as GroundAcceleration,
    LinearActuator as LinearActuator,
    PointForce as PointForce,
    PointTorque as PointTorque,
)
from .instruments import (
    Accelerometer as Accelerometer,
    ForceSensor as ForceSensor,
    Geophone as Geophone,
    Vibrometer as Vibrometer,
)
from .joints import (
    Joint as Joint,
    cylindrical as cylindrical,
    fixed as fixed,
    planar as planar,
    prismatic as prismatic,
    revolute as revolute,
    spherical as spherical,
    universal as universal,
)
from .loop import (
    Loop as Loop,
)
from .measures import (
    BodyCoordinates as BodyCoordinates,
    BodyState as BodyState,
    Combination as Combination,
    Displacement as Displacement,
    Distance as Distance,
    Measure as Measure,
    PointMeasure as PointMeasure,
    PointVelocity as PointVelocity,
)
from .motion import (
    Motion as Motion,
    point_motion as point_motion,
    seen_from as seen_from,
)
from .motion_sensors import (
    AngleSensor as AngleSensor,
    Encoder as Encoder,
    Pose as Pose,
)
from .part import (
    Actuator as Actuator,
    Connection as Connection,
    ForceElement as ForceElement,
    Part as Part,
    Sensor as Sensor,
)
from .piezo import (
    StackActuator as StackActuator,
    StackSensor as StackSensor,
    VoltageDrive as VoltageDrive,
    VoltageSensor as VoltageSensor,
)
from .placement import (
    joined as joined,
    placed as placed,
)
from .rotation_measures import (
    RelativePose as RelativePose,
    RotationAngle as RotationAngle,
    RotationDeviation as RotationDeviation,
)
from .scene import (
    Scene as Scene,
)
from .springs import (
    Bushing as Bushing,
    SpringDamper as SpringDamper,
)
from .stress_peaks import (
    PeakStress as PeakStress,
    peak_stress as peak_stress,
    sensor_stress as sensor_stress,
)
from .stress_sensors import (
    StrainGauge as StrainGauge,
    StressAt as StressAt,
)
from .terms import (
    AppliedForce as AppliedForce,
    BaseAcceleration as BaseAcceleration,
    CircuitState as CircuitState,
    CoilForce as CoilForce,
    Constraint as Constraint,
    Feedthrough as Feedthrough,
    ForceLaw as ForceLaw,
    NonlinearSpring as NonlinearSpring,
    Output as Output,
    OutputFilter as OutputFilter,
    PrescribedMotion as PrescribedMotion,
    Shunt as Shunt,
    Spring as Spring,
    SpringForce as SpringForce,
    Term as Term,
)
from .voice_coil import (
    CurrentSensor as CurrentSensor,
    VoiceCoil as VoiceCoil,
)
