from .bodies import (
    Body as Body,
)
from .bodies import (
    FlexibleBody as FlexibleBody,
)
from .bodies import (
    RigidBody as RigidBody,
)
from .drives import (
    Drive as Drive,
)
from .instruments import (
    Accelerometer as Accelerometer,
)
from .instruments import (
    ForceSensor as ForceSensor,
)
from .instruments import (
    Geophone as Geophone,
)
from .instruments import (
    Vibrometer as Vibrometer,
)
from .joints import (
    Joint as Joint,
)
from .joints import (
    cylindrical as cylindrical,
)
from .joints import (
    fixed as fixed,
)
from .joints import (
    planar as planar,
)
from .joints import (
    prismatic as prismatic,
)
from .joints import (
    revolute as revolute,
)
from .joints import (
    spherical as spherical,
)
from .joints import (
    universal as universal,
)
from .loop import (
    Loop as Loop,
)
from .measures import (
    Axes as Axes,
)
from .measures import (
    BodyCoordinates as BodyCoordinates,
)
from .measures import (
    BodyState as BodyState,
)
from .measures import (
    Combination as Combination,
)
from .measures import (
    Direction as Direction,
)
from .measures import (
    Displacement as Displacement,
)
from .measures import (
    Distance as Distance,
)
from .measures import (
    Measure as Measure,
)
from .measures import (
    Path as Path,
)
from .measures import (
    PointMeasure as PointMeasure,
)
from .measures import (
    PointVelocity as PointVelocity,
)
from .measures import (
    Position as Position,
)
from .measures import (
    RelativePose as RelativePose,
)
from .measures import (
    RotationAngle as RotationAngle,
)
from .measures import (
    Signal as Signal,
)
from .mechanics import (
    AngleSensor as AngleSensor,
)
from .mechanics import (
    Bushing as Bushing,
)
from .mechanics import (
    Encoder as Encoder,
)
from .mechanics import (
    GroundAcceleration as GroundAcceleration,
)
from .mechanics import (
    LinearActuator as LinearActuator,
)
from .mechanics import (
    PointForce as PointForce,
)
from .mechanics import (
    PointTorque as PointTorque,
)
from .mechanics import (
    Pose as Pose,
)
from .mechanics import (
    SpringDamper as SpringDamper,
)
from .motion import (
    Motion as Motion,
)
from .motion import (
    point_motion as point_motion,
)
from .motion import (
    seen_from as seen_from,
)
from .part import (
    Actuator as Actuator,
)
from .part import (
    Connection as Connection,
)
from .part import (
    ForceElement as ForceElement,
)
from .part import (
    Part as Part,
)
from .part import (
    Sensor as Sensor,
)
from .piezo import (
    StackActuator as StackActuator,
)
from .piezo import (
    StackSensor as StackSensor,
)
from .piezo import (
    VoltageDrive as VoltageDrive,
)
from .piezo import (
    VoltageSensor as VoltageSensor,
)
from .placement import (
    joined as joined,
)
from .placement import (
    placed as placed,
)
from .scene import (
    Scene as Scene,
)
from .terms import (
    AppliedForce as AppliedForce,
)
from .terms import (
    BaseAcceleration as BaseAcceleration,
)
from .terms import (
    Constraint as Constraint,
)
from .terms import (
    ForceLaw as ForceLaw,
)
from .terms import (
    NonlinearSpring as NonlinearSpring,
)
from .terms import (
    Output as Output,
)
from .terms import (
    OutputFilter as OutputFilter,
)
from .terms import (
    PrescribedMotion as PrescribedMotion,
)
from .terms import (
    Shunt as Shunt,
)
from .terms import (
    Spring as Spring,
)
from .terms import (
    SpringForce as SpringForce,
)
from .terms import (
    Term as Term,
)
