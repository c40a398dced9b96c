from . import flake as flake
from . import kirchhoff as kirchhoff
from . import lambert_gauss as lambert_gauss
from . import measured as measured
from . import microfacet as microfacet
from . import slab as slab
from . import traced as traced
from .accessor import BSDFAccessor as BSDFAccessor
