from .export import (
    body_damping as body_damping,
)
from .export import (
    body_state_space as body_state_space,
)
from .export import (
    export_body as export_body,
)
from .export import (
    export_model as export_model,
)
from .inspection import (
    Finding as Finding,
)
from .inspection import (
    Report as Report,
)
from .inspection import (
    as_superelement as as_superelement,
)
from .inspection import (
    check as check,
)
from .repairing import (
    Repair as Repair,
)
from .repairing import (
    repair as repair,
)
from .repairing import (
    to_body as to_body,
)
from .superelement import (
    Superelement as Superelement,
)
from .superelement import (
    read_superelement as read_superelement,
)
from .superelement import (
    superelement as superelement,
)
