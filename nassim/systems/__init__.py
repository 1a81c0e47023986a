"""Linear systems: models in state space, controllers, closed loops and their margins, root loci, noise budgets.

The sub-package contains no scene and no body, and importing it loads neither NGSolve nor Exudyn. A new kind of
controller goes to `controllers`, a design rule to `loop_shaping`, a figure of merit of loops to `stability_margins`,
and one of disturbances to `noise_budgets`. `transformed_signals` changes the signals of a model, `interconnection`
connects models, `feedback` closes loops, and `optimal_control` and `linear_quadratic` find controllers for them.
"""

from nassim.lazy_names import attach_names

__getattr__, __dir__, __all__ = attach_names(__name__, __file__)
