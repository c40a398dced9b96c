"""Files that other programs read: one module for each format (see :mod:`brdfpipe.exchange.registry`)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
