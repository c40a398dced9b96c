"""colour-science without its side effect: it sets numpy's print options for the whole process.

The import takes a second and 45 MB. Import this module where colour-science is used, inside the function; the pool of workers preloads
it once for the stages whose code contains it.
"""

import numpy as np

with np.printoptions():
    import colour as _colour

colour = _colour
