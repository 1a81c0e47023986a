"""nassim: multibody simulation with reduced-order flexible bodies.

The names of the chain, from CAD to frequency responses, loaded when they are first used; each sub-package has more:
`nassim.signals`, `nassim.bodies`, `nassim.kinematics`, `nassim.systems`, `nassim.fem`, `nassim.scene`,
`nassim.exchange`, `nassim.simulation`, `nassim.identification`, `nassim.studies`, `nassim.plotting`, `nassim.viewer`.
"""

from nassim.lazy_names import attach_names

__getattr__, __dir__, __all__ = attach_names(__name__, __file__)
__version__ = "0.3.0.dev0"
