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
from .coordinates import (
    with_inputs as with_inputs,
    with_outputs as with_outputs,
)
from .fatigue import (
    StressCycles as StressCycles,
    WoehlerLine as WoehlerLine,
    count_cycles as count_cycles,
    damage_rate as damage_rate,
)
from .feedback import (
    Margins as Margins,
    close_loop as close_loop,
    controller_model as controller_model,
    loop_at_a_time as loop_at_a_time,
    loop_response as loop_response,
    margins as margins,
    open_loop as open_loop,
    sensitivity as sensitivity,
    singular_values as singular_values,
)
from .folding import (
    FoldingMode as FoldingMode,
    folding_modes as folding_modes,
)
from .linear_model import (
    LinearModel as LinearModel,
    UnstablePole as UnstablePole,
    damping as damping,
    frequency_response as frequency_response,
    sampled as sampled,
    transmissibility as transmissibility,
    unstable_poles as unstable_poles,
    zeros as zeros,
)
from .loop_shaping import (
    crossover_controller as crossover_controller,
)
from .noise_budgets import (
    NoiseBudget as NoiseBudget,
    noise_budget as noise_budget,
)
from .python_control import (
    controller_from_control as controller_from_control,
    model_from_control as model_from_control,
    to_control as to_control,
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
from .state_space import (
    cascade as cascade,
    discretize as discretize,
    inverse_tustin as inverse_tustin,
    transfer_matrix as transfer_matrix,
    transmission_zeros as transmission_zeros,
    tustin as tustin,
)
from .stress_noise import (
    von_mises_budget as von_mises_budget,
)
