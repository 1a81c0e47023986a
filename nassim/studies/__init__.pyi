from .samples import (
    Samples as Samples,
)
from .sampling_plans import (
    latin_hypercube as latin_hypercube,
    random_points as random_points,
    saltelli_points as saltelli_points,
    sobol_points as sobol_points,
)
from .sensitivity import (
    correlations as correlations,
    linear_effects as linear_effects,
    sobol_indices as sobol_indices,
)
from .sweeping import (
    sweep as sweep,
)
