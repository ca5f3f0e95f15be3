from .calibration.device import Calibration as Calibration
from .calibration.device import CalibrationPlan as CalibrationPlan
from .calibration.device import DrivePoint as DrivePoint
from .calibration.device import SweepPoint as SweepPoint
