from .controllers import (
    Controller as Controller,
)
from .controllers import (
    controller_response as controller_response,
)
from .controllers import (
    decentralised as decentralised,
)
from .controllers import (
    decoupled as decoupled,
)
from .controllers import (
    integral_force_feedback as integral_force_feedback,
)
from .controllers import (
    lead as lead,
)
from .controllers import (
    notch as notch,
)
from .controllers import (
    parallel as parallel,
)
from .controllers import (
    proportional as proportional,
)
from .controllers import (
    series as series,
)
from .coordinates import (
    with_inputs as with_inputs,
)
from .coordinates import (
    with_outputs as with_outputs,
)
from .feedback import (
    Margins as Margins,
)
from .feedback import (
    close_loop as close_loop,
)
from .feedback import (
    controller_model as controller_model,
)
from .feedback import (
    loop_at_a_time as loop_at_a_time,
)
from .feedback import (
    loop_response as loop_response,
)
from .feedback import (
    margins as margins,
)
from .feedback import (
    open_loop as open_loop,
)
from .feedback import (
    sensitivity as sensitivity,
)
from .feedback import (
    singular_values as singular_values,
)
from .folding import (
    FoldingMode as FoldingMode,
)
from .folding import (
    folding_modes as folding_modes,
)
from .linear_model import (
    LinearModel as LinearModel,
)
from .linear_model import (
    UnstablePole as UnstablePole,
)
from .linear_model import (
    damping as damping,
)
from .linear_model import (
    frequency_response as frequency_response,
)
from .linear_model import (
    sampled as sampled,
)
from .linear_model import (
    transmissibility as transmissibility,
)
from .linear_model import (
    unstable_poles as unstable_poles,
)
from .linear_model import (
    zeros as zeros,
)
from .loop_shaping import (
    crossover_controller as crossover_controller,
)
from .noise_budget import (
    NoiseBudget as NoiseBudget,
)
from .noise_budget import (
    noise_budget as noise_budget,
)
from .python_control import (
    controller_from_control as controller_from_control,
)
from .python_control import (
    model_from_control as model_from_control,
)
from .python_control import (
    to_control as to_control,
)
from .python_controller import (
    PythonController as PythonController,
)
from .root_locus import (
    Optimum as Optimum,
)
from .root_locus import (
    RootLocus as RootLocus,
)
from .root_locus import (
    iff_optimum as iff_optimum,
)
from .root_locus import (
    largest_stable_gain as largest_stable_gain,
)
from .root_locus import (
    optimum_gain as optimum_gain,
)
from .root_locus import (
    root_locus as root_locus,
)
from .state_space import (
    cascade as cascade,
)
from .state_space import (
    discretize as discretize,
)
from .state_space import (
    inverse_tustin as inverse_tustin,
)
from .state_space import (
    transfer_matrix as transfer_matrix,
)
from .state_space import (
    transmission_zeros as transmission_zeros,
)
from .state_space import (
    tustin as tustin,
)
