"""Views of bodies, modes, scenes and their motion: one HTML file that opens anywhere, and pictures for reports.

`views` makes a view of an object, and `write_page` and `save_picture` show it. A new kind of object goes to
`views`, the appearance of a body without a surface to `forms`, and the mark of a part to `marks`, which uses only
the terms of the part. The program of the page is `page/viewer.js`. Pictures need PyVista, the extra "viewer"; pages
need no further package.
"""

from nassim.lazy_names import attach_names

__getattr__, __dir__, __all__ = attach_names(__name__, __file__)
