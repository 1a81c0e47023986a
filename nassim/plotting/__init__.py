"""Pictures of finished results: each function takes a result of another wing and returns its Axes.

The one home of matplotlib. What all pictures share lives in `figures`; to add a picture, open the room of its idea
(`responses`, `root_loci`, `budgets`, `histories`, `bodies`, `inspection`, `pareto`, `studies`) or make one for a new
idea.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
