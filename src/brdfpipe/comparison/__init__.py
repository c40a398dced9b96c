"""A measured BRDF beside the one that the surface predicts, and the inputs of the prediction that would make them agree."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
