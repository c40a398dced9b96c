"""Scenes: what a BRDF is for, the directions and results that this needs, and the error that matters to it."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
