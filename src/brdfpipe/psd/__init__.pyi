from .analytic_spectra import FORMS as FORMS
from .analytic_spectra import analytic as analytic
from .k_correlation import PsdError as PsdError
