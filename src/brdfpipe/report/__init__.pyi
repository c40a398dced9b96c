from .catalogue.page import catalogue_page as catalogue_page
from .catalogue.rows import catalogue_csv as catalogue_csv
from .catalogue.rows import combine as combine
from .catalogue.rows import lock as lock
from .catalogue.rows import summarise as summarise
from .material.page import material_page as material_page
