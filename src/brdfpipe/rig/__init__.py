"""The camera rig: its devices and the scan, an emulator, and the reduction of frames to a primary BSDF."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
