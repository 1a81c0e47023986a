from .eta import (
    whole_run as whole_run,
)
from .file_registry import (
    register as register,
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
    cached as cached,
    code_fingerprint as code_fingerprint,
    fingerprint as fingerprint,
    load as load,
    save as save,
    written_whole as written_whole,
)
