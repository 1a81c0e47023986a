from .comparison import (
    Comparison as Comparison,
    compare as compare,
)
from .floating_frames import (
    FloatingFrame as FloatingFrame,
    floating_frame as floating_frame,
)
from .inertia import (
    RigidInertia as RigidInertia,
    rigid_inertia as rigid_inertia,
)
from .piezo import (
    ElectricalPort as ElectricalPort,
    PiezoStack as PiezoStack,
    PortCoupling as PortCoupling,
)
from .projection import (
    keep_modes as keep_modes,
    keep_ports as keep_ports,
    open_circuit as open_circuit,
    project as project,
    trim_body as trim_body,
)
from .readouts import (
    PassivePoint as PassivePoint,
    Picture as Picture,
    Readout as Readout,
    Surface as Surface,
)
from .reduced_body import (
    ReducedBody as ReducedBody,
)
from .remote_points import (
    RemotePoint as RemotePoint,
)
from .stress import (
    GaugeStrain as GaugeStrain,
    StressField as StressField,
    principal_stresses as principal_stresses,
    von_mises as von_mises,
)
from .stress_stiffness import (
    StressStiffness as StressStiffness,
)
