"""What people look at: a page a material, a catalogue of all of them, and the catalogue as a table.

Every page is one file that asks nothing of anybody else: no font, script or picture from elsewhere. What users wrote is
shown as text and never as markup.
"""

from __future__ import annotations

from brdfpipe.report.catalogue import catalogue_csv, catalogue_page, combine, lock, summarise
from brdfpipe.report.material import material_page

__all__ = ["catalogue_csv", "catalogue_page", "combine", "lock", "material_page", "summarise"]
