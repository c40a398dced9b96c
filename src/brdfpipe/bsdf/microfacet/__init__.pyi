from .builder import build as build
from .microsurface import ModelError as ModelError
