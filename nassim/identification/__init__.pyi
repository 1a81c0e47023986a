from .apply import (
    Change as Change,
)
from .apply import (
    UpdateReport as UpdateReport,
)
from .apply import (
    apply_identification as apply_identification,
)
from .apply import (
    modal_gains as modal_gains,
)
from .calibration import (
    Calibration as Calibration,
)
from .calibration import (
    Parameter as Parameter,
)
from .calibration import (
    Target as Target,
)
from .calibration import (
    at_bounds as at_bounds,
)
from .calibration import (
    calibrate as calibrate,
)
from .calibration import (
    check_determined as check_determined,
)
from .calibration import (
    sensitivities as sensitivities,
)
from .modal_fit import (
    ModalFit as ModalFit,
)
from .modal_fit import (
    identify_modes as identify_modes,
)
