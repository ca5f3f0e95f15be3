from .arrays import BoolArray as BoolArray
from .arrays import FloatArray as FloatArray
from .coil_heat import ThermalCoil as ThermalCoil
from .limits import BrokenLimit as BrokenLimit
from .operator import Operator as Operator
