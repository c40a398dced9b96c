"""Pages for people: one a material, one of the catalogue, and the catalogue as a table.

Every page is one file that needs nothing from elsewhere: no font, script or picture. What users wrote is shown as text and
never as markup.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
