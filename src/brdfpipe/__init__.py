"""brdfpipe: trustworthy BRDFs for a catalogue of plastics, paints and films, from what a laboratory has.

Submodules load when they are first used, so that ``import brdfpipe`` costs nothing and a stage depends on what it needs alone.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
