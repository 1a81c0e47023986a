"""Bodies, modes, scenes and their motion to look at: one HTML file that opens anywhere, and pictures for reports.

`subjects` makes a view of what the chain made, `write_page` and `save_picture` show it. To show another kind of thing,
open `subjects`; what a body without a surface looks like, `forms`; what a part's mark is, `marks`, which asks only
what the part says. The page's program is `page/viewer.js`; pictures need PyVista, the extra "viewer", pages nothing.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
