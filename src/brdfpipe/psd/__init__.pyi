from .analytic_spectra import FORMS as FORMS
from .analytic_spectra import analytic as analytic
from .estimation import estimate as estimate
from .joining import estimate_joined as estimate_joined
from .joining import join as join
from .k_correlation import PsdError as PsdError
from .scaling import scaled as scaled
