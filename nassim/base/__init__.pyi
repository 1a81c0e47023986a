from .file_registry import (
    register as register,
)
from .memory import (
    peak_memory as peak_memory,
)
from .modal import (
    decay_poles as decay_poles,
    eigenmodes as eigenmodes,
    mac as mac,
    modal_damping_matrix as modal_damping_matrix,
)
from .progress import (
    stage as stage,
)
from .rigid_motion import (
    rigid_motions as rigid_motions,
    rigid_transfer as rigid_transfer,
    skew as skew,
    unit_vector as unit_vector,
)
from .storage import (
    cache_directory as cache_directory,
    code_fingerprint as code_fingerprint,
    fingerprint as fingerprint,
    load as load,
    load_or_compute as load_or_compute,
    save as save,
    write_atomically as write_atomically,
)
from .time_left import (
    show_time_left as show_time_left,
)
