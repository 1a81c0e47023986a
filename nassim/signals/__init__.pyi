from .excitations import (
    band_limited_noise as band_limited_noise,
)
from .excitations import (
    chirp as chirp,
)
from .excitations import (
    low_pass as low_pass,
)
from .excitations import (
    multisine as multisine,
)
from .excitations import (
    orthogonal_multisines as orthogonal_multisines,
)
from .excitations import (
    remove_settling as remove_settling,
)
from .excitations import (
    sine_dwell as sine_dwell,
)
from .excitations import (
    step as step,
)
from .files import (
    read_frf as read_frf,
)
from .files import (
    read_measurement as read_measurement,
)
from .files import (
    read_record as read_record,
)
from .files import (
    write_record as write_record,
)
from .frf import (
    FRF as FRF,
)
from .frf import (
    estimate_frf as estimate_frf,
)
from .spectra import (
    TabulatedSpectrum as TabulatedSpectrum,
)
from .spectra import (
    amplifier_noise as amplifier_noise,
)
from .spectra import (
    differentiate_spectrum as differentiate_spectrum,
)
from .spectra import (
    quantisation_noise as quantisation_noise,
)
from .time_history import (
    TimeHistory as TimeHistory,
)
from .time_history import (
    occupied_bandwidth as occupied_bandwidth,
)
from .time_history import (
    sample_times as sample_times,
)
