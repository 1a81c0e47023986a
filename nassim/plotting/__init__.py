"""Figures of finished results: each function takes a result of another sub-package and returns its Axes.

This is the only sub-package that imports matplotlib. `figures` contains the common parts of all figures. A new figure
goes to the module of its subject (`responses`, `loops`, `root_loci`, `budgets`, `histories`, `inspection`, `pareto`,
`studies`), or to a new module for a new subject.
"""

from nassim.lazy_names import attach_names

__getattr__, __dir__, __all__ = attach_names(__name__, __file__)
