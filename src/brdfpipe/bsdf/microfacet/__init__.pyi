from .builder import ModelError as ModelError
from .builder import build as build
