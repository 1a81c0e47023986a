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
    Axes as Axes,
)
from .part import (
    Connection as Connection,
)
from .part import (
    Constraint as Constraint,
)
from .part import (
    Direction as Direction,
)
from .part import (
    Field as Field,
)
from .part import (
    Filter as Filter,
)
from .part import (
    Force as Force,
)
from .part import (
    ForceElement as ForceElement,
)
from .part import (
    Leak as Leak,
)
from .part import (
    Line as Line,
)
from .part import (
    Part as Part,
)
from .part import (
    Path as Path,
)
from .part import (
    Position as Position,
)
from .part import (
    Reading as Reading,
)
from .part import (
    Row as Row,
)
from .part import (
    Sensor as Sensor,
)
from .part import (
    Signal as Signal,
)
from .part import (
    SixSprings as SixSprings,
)
from .part import (
    Spring as Spring,
)
from .part import (
    Tension as Tension,
)
from .part import (
    Word as Word,
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
