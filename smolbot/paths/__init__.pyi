from .speed_profile import SpeedProfile as SpeedProfile
