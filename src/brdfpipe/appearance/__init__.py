"""How a material appears to people and instruments: gloss, haze, colour, and a preview."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
