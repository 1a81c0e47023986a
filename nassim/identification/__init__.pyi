from .apply import (
    Change as Change,
    UpdateReport as UpdateReport,
    apply_identification as apply_identification,
    modal_gains as modal_gains,
)
from .calibration import (
    Calibration as Calibration,
    Parameter as Parameter,
    Target as Target,
    at_bounds as at_bounds,
    calibrate as calibrate,
    check_determined as check_determined,
    sensitivities as sensitivities,
)
from .modal_fit import (
    ModalFit as ModalFit,
    identify_modes as identify_modes,
)
