"""The waist: an evaluable ``bsdf`` dataset, however the material came in.

Importing anything of this package gives datasets their accessor ``.bsdf``; what the accessor needs loads when it is first used.
"""

import lazy_loader
import xarray as xr

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

# The accessor is for people. Stages call the functions behind it, so that the digest of a stage's code covers just what it uses.
xr.register_dataset_accessor("bsdf")(lambda dataset: __getattr__("BSDFAccessor")(dataset))
