"""Figures of a BSDF for notebooks and files, by matplotlib (``pip install 'brdfpipe[plot]'``): ``dataset.bsdf.plot``."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
