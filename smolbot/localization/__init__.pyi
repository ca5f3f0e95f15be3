from .localizer import Swing as Swing
from .problem import Fit as Fit
from .problem import Problem as Problem
