from .excitations import (
    band_limited_noise as band_limited_noise,
    chirp as chirp,
    low_pass as low_pass,
    multisine as multisine,
    orthogonal_multisines as orthogonal_multisines,
    remove_settling as remove_settling,
    sine_dwell as sine_dwell,
    spectral_noise as spectral_noise,
    step as step,
)
from .files import (
    read_frf as read_frf,
    read_measurement as read_measurement,
    read_record as read_record,
    write_record as write_record,
)
from .frf import (
    FRF as FRF,
    estimate_frf as estimate_frf,
)
from .motion_paths import (
    DriveLimits as DriveLimits,
    back_and_forth as back_and_forth,
    check_path as check_path,
    shortest_step as shortest_step,
    smooth_step as smooth_step,
    turned as turned,
)
from .spectra import (
    TabulatedSpectrum as TabulatedSpectrum,
    amplifier_noise as amplifier_noise,
    differentiate_spectrum as differentiate_spectrum,
    estimate_spectrum as estimate_spectrum,
    quantisation_noise as quantisation_noise,
)
from .time_history import (
    TimeHistory as TimeHistory,
    occupied_bandwidth as occupied_bandwidth,
    sample_times as sample_times,
    settling_time as settling_time,
)
