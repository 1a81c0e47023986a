"""Studies: many runs of one function, with sampling plans, sweeps on one machine or a cluster, and sensitivity
analysis.

A new way to choose the runs goes to `sampling_plans`, which return `Samples`; a new sensitivity figure to
`sensitivity`, a new kind of result to `results`, a new status of a run to `outcome`, and a new place to carry out runs
to `executors`. Results are labelled arrays of xarray, which plots and saves them. The extra `studies` installs the
additional packages of this sub-package.
"""

from nassim.lazy_names import attach_names

__getattr__, __dir__, __all__ = attach_names(__name__, __file__)
