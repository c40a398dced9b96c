from .catalogue.page import catalogue_page as catalogue_page
from .catalogue.rows import combine as combine
from .catalogue.rows import summarise as summarise
from .catalogue.table import catalogue_csv as catalogue_csv
from .catalogue.table import lock as lock
from .material.page import material_page as material_page
