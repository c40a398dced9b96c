"""How stages run: code digests, one stage in a worker, the pool of workers, and the build."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
