from .control_conversion import (
    controller_from_control as controller_from_control,
    model_from_control as model_from_control,
    to_control as to_control,
)
from .controller_models import (
    controller_from_model as controller_from_model,
    controller_model as controller_model,
)
from .controllers import (
    Controller as Controller,
    controller_response as controller_response,
    decentralised as decentralised,
    decoupled as decoupled,
    integral_force_feedback as integral_force_feedback,
    lead as lead,
    notch as notch,
    parallel as parallel,
    pid as pid,
    proportional as proportional,
    series as series,
)
from .decoupling import (
    modal_decoupling as modal_decoupling,
    relative_gain_array as relative_gain_array,
    svd_decoupling as svd_decoupling,
    uncoupled_point as uncoupled_point,
)
from .fatigue import (
    StressCycles as StressCycles,
    WoehlerLine as WoehlerLine,
    count_cycles as count_cycles,
    damage_rate as damage_rate,
)
from .feedback import (
    close_loop as close_loop,
    loop_at_a_time as loop_at_a_time,
    loop_response as loop_response,
    open_loop as open_loop,
    sensitivity as sensitivity,
    singular_values as singular_values,
)
from .folding import (
    FoldingMode as FoldingMode,
    folding_modes as folding_modes,
)
from .interconnection import (
    interconnect as interconnect,
    static_gain as static_gain,
    weighting_filter as weighting_filter,
)
from .linear_model import (
    LinearModel as LinearModel,
    UnstablePole as UnstablePole,
    damping as damping,
    frequency_response as frequency_response,
    sampled as sampled,
    subsystem as subsystem,
    transmissibility as transmissibility,
    unstable_poles as unstable_poles,
    zeros as zeros,
)
from .linear_quadratic import (
    lqg as lqg,
)
from .loop_shaping import (
    crossover_controller as crossover_controller,
)
from .model_reduction import (
    BalancedTruncation as BalancedTruncation,
    balanced_truncation as balanced_truncation,
)
from .noise_budgets import (
    NoiseBudget as NoiseBudget,
    noise_budget as noise_budget,
    recorded_budget as recorded_budget,
)
from .norms import (
    h2_norm as h2_norm,
    hinf_norm as hinf_norm,
)
from .optimal_control import (
    Synthesis as Synthesis,
    h2_synthesis as h2_synthesis,
    hinf_synthesis as hinf_synthesis,
    mixed_sensitivity as mixed_sensitivity,
)
from .plant_families import (
    FamilyMargins as FamilyMargins,
    family_margins as family_margins,
)
from .python_controller import (
    PythonController as PythonController,
)
from .root_loci import (
    Optimum as Optimum,
    RootLocus as RootLocus,
    iff_optimum as iff_optimum,
    largest_stable_gain as largest_stable_gain,
    optimum_gain as optimum_gain,
    root_locus as root_locus,
)
from .rotating_budgets import (
    rotating_noise_budget as rotating_noise_budget,
)
from .sensor_fusion import (
    ComplementaryFilters as ComplementaryFilters,
    complementary_filters as complementary_filters,
    h2_complementary_filters as h2_complementary_filters,
    hinf_complementary_filters as hinf_complementary_filters,
)
from .stability_margins import (
    Margins as Margins,
    margins as margins,
)
from .state_space import (
    cascade as cascade,
    discretize as discretize,
    inverse_tustin as inverse_tustin,
    transmission_zeros as transmission_zeros,
    tustin as tustin,
)
from .stress_noise import (
    von_mises_budget as von_mises_budget,
)
from .transfer_matrices import (
    transfer_matrix as transfer_matrix,
)
from .transformed_signals import (
    with_inputs as with_inputs,
    with_outputs as with_outputs,
)
