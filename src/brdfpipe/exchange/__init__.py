"""Files other programs read: one module a format."""

from brdfpipe.exchange import astm as astm
from brdfpipe.exchange.companions import write_lambert_gauss as write_lambert_gauss
from brdfpipe.exchange.companions import write_total_reflectance as write_total_reflectance

FORMATS = ("astm",)
"""Names accepted by a material's ``exports``."""
