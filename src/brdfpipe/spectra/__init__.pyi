from .ingestion import ingest as ingest
from .readers import read_spectrum as read_spectrum
from .recovery import metamerism as metamerism
from .recovery import recover as recover
