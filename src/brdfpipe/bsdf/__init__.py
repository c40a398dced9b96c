"""The waist: an evaluable ``bsdf`` dataset, however the material came in.

Importing this package gives datasets their ``.bsdf`` accessor.
"""

from brdfpipe.bsdf import accessor as accessor
from brdfpipe.bsdf.microfacet import build as build
