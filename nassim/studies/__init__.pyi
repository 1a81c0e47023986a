from .plans import (
    latin_hypercube as latin_hypercube,
)
from .plans import (
    random_points as random_points,
)
from .plans import (
    saltelli_points as saltelli_points,
)
from .plans import (
    sobol_points as sobol_points,
)
from .samples import (
    Samples as Samples,
)
from .sensitivity import (
    correlations as correlations,
)
from .sensitivity import (
    linear_effects as linear_effects,
)
from .sensitivity import (
    sobol_indices as sobol_indices,
)
from .sweeping import (
    sweep as sweep,
)
