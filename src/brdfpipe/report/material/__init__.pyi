from .page import material_page as material_page
