"""What every wing stands on: checks of input, progress, files, locks, dense modal algebra, rigid motions of points.

Nothing here knows a body, a signal or a scene; nothing but NumPy, SciPy and what reads and writes files is needed.
To add a check of arguments, open `checks`; a noun that files may hold, `nouns`; a unit, `units`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
