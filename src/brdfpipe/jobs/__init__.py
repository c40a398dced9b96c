"""How stages run: code digests, one stage in a worker, the pool of workers, what the rules ask, the build front."""

from __future__ import annotations

from brdfpipe.jobs.stage import by_hand

__all__ = ["by_hand"]
