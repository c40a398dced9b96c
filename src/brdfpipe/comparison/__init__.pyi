from .measured_predicted import MOST_WAVELENGTHS as MOST_WAVELENGTHS
from .measured_predicted import adjusted as adjusted
from .measured_predicted import compare as compare
from .measurement import ComparisonError as ComparisonError
