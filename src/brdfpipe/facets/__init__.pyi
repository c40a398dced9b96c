from .analytic_distributions import DISTRIBUTIONS as DISTRIBUTIONS
from .analytic_distributions import analytic as analytic
from .analytic_distributions import flat as flat
from .estimation import estimate as estimate
from .facet_dataset import azimuthal_average as azimuthal_average
from .scaling import scaled as scaled
from .slope_histogram import FacetError as FacetError
