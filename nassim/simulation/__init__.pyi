from .accuracy import (
    integrator_error as integrator_error,
)
from .accuracy import (
    numerical_damping as numerical_damping,
)
from .accuracy import (
    period_errors as period_errors,
)
from .accuracy import (
    truncation_error as truncation_error,
)
from .damping import (
    Damping as Damping,
)
from .description import (
    describe as describe,
)
from .linearization import (
    linearize as linearize,
)
from .linearization import (
    linearize_closed as linearize_closed,
)
from .linearization import (
    spinning_equilibrium as spinning_equilibrium,
)
from .linearization import (
    state_space as state_space,
)
from .recording import (
    scene_modes as scene_modes,
)
from .recording import (
    traced as traced,
)
from .scene_body import (
    reduce_scene as reduce_scene,
)
from .small_motion import (
    Assembly as Assembly,
)
from .small_motion import (
    assemble as assemble,
)
from .spinning import (
    Spinning as Spinning,
)
from .spinning import (
    spinning as spinning,
)
from .stopped_runs import (
    SimulationError as SimulationError,
)
from .stopped_runs import (
    SimulationInterrupted as SimulationInterrupted,
)
from .swinging import (
    mode_motion as mode_motion,
)
from .time_domain import (
    exudyn_eigenfrequencies as exudyn_eigenfrequencies,
)
from .time_domain import (
    simulate as simulate,
)
from .time_domain import (
    simulate_motion as simulate_motion,
)
from .time_domain import (
    static_response as static_response,
)
from .trimming import (
    trim_scene as trim_scene,
)
