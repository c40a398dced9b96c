"""Fresnel's equations, refractive indices, dispersion, and the inside of a clear body."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
