from .description import Rig as Rig
from .frames import read_run as read_run
from .plan import Plan as Plan
from .reduction.calibration import calibrate as calibrate
from .reduction.certificate import Certificate as Certificate
from .reduction.primary import apply_profile as apply_profile
from .reduction.relative_light import reduce as reduce
