from .linear.closed_linearization import (
    linearize_closed as linearize_closed,
)
from .linear.linearization import (
    linearize as linearize,
    spinning_equilibrium as spinning_equilibrium,
)
from .linear.mode_motion import (
    mode_motion as mode_motion,
)
from .linear.scene_state_space import (
    state_space as state_space,
)
from .linear.truncation import (
    truncation_error as truncation_error,
)
from .loaded.buckling_factors import (
    buckling_factors as buckling_factors,
)
from .loaded.loaded_equilibrium import (
    LoadedEquilibrium as LoadedEquilibrium,
    loaded_equilibrium as loaded_equilibrium,
)
from .loaded.loaded_state import (
    loaded_state as loaded_state,
)
from .loaded.scene_body import (
    reduce_scene as reduce_scene,
)
from .loaded.stress_convergence import (
    StressConvergence as StressConvergence,
    StressSpot as StressSpot,
    stress_convergence as stress_convergence,
)
from .loaded.stress_limits import (
    LoadLimit as LoadLimit,
    load_limit as load_limit,
    static_motion as static_motion,
)
from .model.assembly import (
    Assembly as Assembly,
    assemble as assemble,
)
from .model.damping import (
    Damping as Damping,
)
from .model.description import (
    describe as describe,
)
from .model.effect_of_loads import (
    LoadedState as LoadedState,
)
from .model.recorded_motion import (
    scene_modes as scene_modes,
    traced as traced,
)
from .model.step_errors import (
    command_error as command_error,
    integrator_error as integrator_error,
    numerical_damping as numerical_damping,
    period_errors as period_errors,
)
from .model.stopped_runs import (
    SimulationError as SimulationError,
    SimulationInterrupted as SimulationInterrupted,
)
from .model.trimming import (
    trim_scene as trim_scene,
)
from .run.simulate import (
    exudyn_eigenfrequencies as exudyn_eigenfrequencies,
    simulate as simulate,
    simulate_motion as simulate_motion,
    static_response as static_response,
)
from .run.step_by_step import (
    Simulation as Simulation,
    SimulationState as SimulationState,
)
