"""Many runs of one function: sampling plans, sweeps on one machine or a cluster, what their results tell.

To add a way of choosing the runs, open `plans`, which give `Samples`; a figure of what moves the results,
`sensitivity`; a kind of result, `results`; what may become of a run, `outcome`; a place where runs are carried out,
`executors`. Results are labelled arrays of xarray, which plots and saves them. The extra `studies` brings what this
wing needs beside the core.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
