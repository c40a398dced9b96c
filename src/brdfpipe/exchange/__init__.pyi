from .registry import FORMATS as FORMATS
from .registry import ExchangeError as ExchangeError
from .registry import Format as Format
from .registry import write as write
from .sidecar_tables import write_lambert_gauss as write_lambert_gauss
from .sidecar_tables import write_total_reflectance as write_total_reflectance
from .sidecar_tables import write_total_transmittance as write_total_transmittance
