from .distant_view import structure_preview as structure_preview
from .map_files import write_maps as write_maps
from .picture_files import write_pictures as write_pictures
from .picture_texture import of_pictures as of_pictures
from .scan_texture import facets_of as facets_of
from .scan_texture import of_scan as of_scan
from .textured import Textured as Textured
