"""The visible structure beside the BRDF: tileable maps of a grain, textures of effect paints, and BRDFs at places of a surface."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
