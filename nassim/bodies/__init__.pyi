from .floating_frame import (
    FloatingFrame as FloatingFrame,
)
from .floating_frame import (
    floating_frame as floating_frame,
)
from .inertia import (
    RigidInertia as RigidInertia,
)
from .inertia import (
    rigid_inertia as rigid_inertia,
)
from .interface import (
    RemotePoint as RemotePoint,
)
from .piezo import (
    ElectricalPort as ElectricalPort,
)
from .piezo import (
    PiezoStack as PiezoStack,
)
from .piezo import (
    PortCoupling as PortCoupling,
)
from .projection import (
    keep_modes as keep_modes,
)
from .projection import (
    keep_ports as keep_ports,
)
from .projection import (
    open_circuit as open_circuit,
)
from .projection import (
    project as project,
)
from .projection import (
    trim_body as trim_body,
)
from .readouts import (
    PassivePoint as PassivePoint,
)
from .readouts import (
    Picture as Picture,
)
from .readouts import (
    Readout as Readout,
)
from .readouts import (
    Surface as Surface,
)
from .reduced_body import (
    ReducedBody as ReducedBody,
)
