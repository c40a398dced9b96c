from .filtering import high_pass as high_pass
from .filtering import low_pass as low_pass
from .levelling import level as level
from .reading import ingest as ingest
from .reading import read_surface as read_surface
from .texture_parameters import parameters as parameters
from .x3p import write_x3p as write_x3p
