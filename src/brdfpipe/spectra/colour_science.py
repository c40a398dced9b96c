"""colour-science without its side effects: it sets numpy's print options, and warns if matplotlib is not installed.

The import takes a second and 45 MB. Import this module where colour-science is used, inside the function; the pool of workers preloads
it once for the stages whose code contains it.
"""

import warnings

import numpy as np

with np.printoptions(), warnings.catch_warnings():
    warnings.filterwarnings("ignore", message=".*related API features.* not available")
    import colour as _colour

colour = _colour
