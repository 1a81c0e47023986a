from .linear.linearization import (
    linearize as linearize,
)
from .linear.linearization import (
    linearize_closed as linearize_closed,
)
from .linear.linearization import (
    spinning_equilibrium as spinning_equilibrium,
)
from .linear.linearization import (
    state_space as state_space,
)
from .linear.mode_motion import (
    mode_motion as mode_motion,
)
from .linear.stopped_runs import (
    SimulationError as SimulationError,
)
from .linear.stopped_runs import (
    SimulationInterrupted as SimulationInterrupted,
)
from .loaded.spinning import (
    Spinning as Spinning,
)
from .loaded.spinning import (
    spinning as spinning,
)
from .model.accuracy import (
    integrator_error as integrator_error,
)
from .model.accuracy import (
    numerical_damping as numerical_damping,
)
from .model.accuracy import (
    period_errors as period_errors,
)
from .model.accuracy import (
    truncation_error as truncation_error,
)
from .model.assembly import (
    Assembly as Assembly,
)
from .model.assembly import (
    assemble as assemble,
)
from .model.damping import (
    Damping as Damping,
)
from .model.description import (
    describe as describe,
)
from .model.recorded_motion import (
    scene_modes as scene_modes,
)
from .model.recorded_motion import (
    traced as traced,
)
from .model.scene_body import (
    reduce_scene as reduce_scene,
)
from .model.trimming import (
    trim_scene as trim_scene,
)
from .run.simulate import (
    exudyn_eigenfrequencies as exudyn_eigenfrequencies,
)
from .run.simulate import (
    simulate as simulate,
)
from .run.simulate import (
    simulate_motion as simulate_motion,
)
from .run.simulate import (
    static_response as static_response,
)
from .run.simulation import (
    Simulation as Simulation,
)
from .run.simulation import (
    SimulationState as SimulationState,
)
