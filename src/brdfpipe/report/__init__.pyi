from .catalogue import catalogue_csv as catalogue_csv
from .catalogue import catalogue_page as catalogue_page
from .catalogue import combine as combine
from .catalogue import lock as lock
from .catalogue import summarise as summarise
from .material.page import material_page as material_page
