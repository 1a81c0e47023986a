from .samples import (
    Samples as Samples,
)
from .sweeping import (
    sweep as sweep,
)
