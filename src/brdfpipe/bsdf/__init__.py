"""Evaluable ``bsdf`` datasets of any source; importing the package registers the accessor ``.bsdf``, which loads at first use."""

import lazy_loader
import xarray as xr

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

# The accessor is for people. Stages call the functions behind it, so that the digest of a stage's code covers only the code it uses.
xr.register_dataset_accessor("bsdf")(lambda dataset: __getattr__("BSDFAccessor")(dataset))
