"""Effect pigments: colours at several geometries, the flakes that mirror them below a clear coat, and fits along the flake angle."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
