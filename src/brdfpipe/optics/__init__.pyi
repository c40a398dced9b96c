from .fresnel_equations import Fresnel as Fresnel
from .fresnel_equations import fresnel as fresnel
from .fresnel_equations import mean_fresnel as mean_fresnel
from .index import INDEX_SPAN as INDEX_SPAN
from .index import NAMED_INDEX as NAMED_INDEX
from .index import interpolate_index as interpolate_index
from .index import refractive_index as refractive_index
