"""Linear systems: models in state space, controllers, closed loops and their margins, root loci, noise budgets.

No scene and no body in here; loading it loads neither NGSolve nor Exudyn. To add a kind of controller, open
`controllers`; a rule that designs one, `loop_shaping`; a figure of merit of loops, `feedback`; of disturbances,
`noise_budget`. `coordinates` has other coordinates for a model's signals.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
