from .estimator import Oscillation as Oscillation
from .estimator import PoseEstimator as PoseEstimator
from .estimator import PoseEstimatorBase as PoseEstimatorBase
from .localizer import Swing as Swing
from .problem import Fit as Fit
from .problem import Problem as Problem
