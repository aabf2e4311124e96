"""What moves in the images of a strip: read `detection`, then `likelihood` and `spectrum`."""

from sal_height.movers.detection import Looked, Mover, check_sensor, find_movers
from sal_height.movers.settings import MoverSettings

__all__ = ["Looked", "Mover", "MoverSettings", "check_sensor", "find_movers"]
