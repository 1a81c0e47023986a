from .eta import (
    show_time_left as show_time_left,
)
from .file_registry import (
    register as register,
)
from .modal import (
    decay_poles as decay_poles,
)
from .modal import (
    eigenmodes as eigenmodes,
)
from .modal import (
    mac as mac,
)
from .modal import (
    modal_damping_matrix as modal_damping_matrix,
)
from .progress import (
    stage as stage,
)
from .rigid_motion import (
    rigid_motions as rigid_motions,
)
from .rigid_motion import (
    rigid_transfer as rigid_transfer,
)
from .rigid_motion import (
    skew as skew,
)
from .rigid_motion import (
    unit_vector as unit_vector,
)
from .storage import (
    cache_directory as cache_directory,
)
from .storage import (
    code_fingerprint as code_fingerprint,
)
from .storage import (
    fingerprint as fingerprint,
)
from .storage import (
    load as load,
)
from .storage import (
    load_or_compute as load_or_compute,
)
from .storage import (
    save as save,
)
from .storage import (
    write_atomically as write_atomically,
)
