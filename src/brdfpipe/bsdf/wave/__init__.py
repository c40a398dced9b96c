"""The wave-optical BSDF of a surface with low slopes, from its roughness spectrum."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
