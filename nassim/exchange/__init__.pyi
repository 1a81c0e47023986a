from .c_code import (
    CCode as CCode,
    export_c as export_c,
)
from .export import (
    body_damping as body_damping,
    body_state_space as body_state_space,
    export_body as export_body,
    export_model as export_model,
)
from .fmu import (
    export_fmu as export_fmu,
)
from .inspection import (
    Finding as Finding,
    Report as Report,
    as_superelement as as_superelement,
    check as check,
)
from .repairing import (
    Repair as Repair,
    repair as repair,
    to_body as to_body,
)
from .superelement_writers import write_superelement as write_superelement
from .superelements import (
    Superelement as Superelement,
    read_calculix as read_calculix,
    read_superelement as read_superelement,
    superelement as superelement,
)
